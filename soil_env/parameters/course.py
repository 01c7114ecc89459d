"""Distribution of courses, and errors of the camera."""

from dataclasses import dataclass

from soil_env._io.loading import Checked, FieldError, quantity

MOST_CLASSES = 6  # [-] terrain classes of a course; own choice
_ROUNDING = 1e-9  # [m] of a difference of lengths


@dataclass(frozen=True)
class CourseSpec(Checked):
    """Distribution of the random courses. All pairs are (low, high) of a uniform distribution.

    Soils and slopes are drawn apart: patches have lengths and soils, slopes lengths and grades of
    their own. So a grade does not show the soil, and some slopes are too steep for their soil. Only
    a soil that leaves this wheel less than `least_pull` on level ground is drawn again. With
    `classes` that is asked of the soil of a class, not of the patches, which scatter about it.

    A border may not be longer than the shortest patch or slope, so that no two borders overlap.

    The wheel is halted every `halt_interval` metres, as rovers are to take the images of visual
    odometry (every 0.75 m at most: Maimone, Cheng & Matthies 2007, J. Field Robotics 24:169-186),
    and has to start again where it stands.

    With `classes` the ground is of that many terrain classes, which a camera can distinguish
    (`Camera`). With `lines` = 2 there are two routes over each patch after the first one of each
    class, and the wheel takes one (docs/physics/wheel.md, "Terrain classes"). Rovers predict slip
    by class to choose a way around ground before they are on it (Angelova, Matthies, Helmick &
    Perona 2007, J. Field Robotics 24:205-231; Rothrock et al. 2016, AIAA SPACE, doi
    10.2514/6.2016-5539).
    """

    length: float = quantity("m", 1.0, 1e4, default=10.0)
    patch_length: tuple[float, float] = quantity("m", 0.2, 1e4, default=(1.2, 3.0))
    border: float = quantity(
        "m", 0.01, 10.0, default=0.3, doc="length over which one patch passes into the next"
    )
    slope_length: tuple[float, float] = quantity("m", 0.2, 1e4, default=(1.2, 3.0))
    grade_deg: tuple[float, float] = quantity("deg", -25.0, 35.0, default=(-6.0, 5.0))
    first_grade_deg: tuple[float, float] = quantity(
        "deg",
        -25.0,
        35.0,
        default=(-6.0, 0.0),
        doc="of the first slope, and of those that begin on the first patch of each class",
    )
    least_pull: float = quantity(
        "of weight",
        -1.0,
        1.0,
        default=0.04,
        doc="best drawbar pull on level ground, below which a soil is drawn again",
    )
    payload: tuple[float, float] = quantity(
        "kg", 0.0, 1e5, default=(0.0, 4.0), doc="on the wheel, of a rover on each"
    )
    halt_interval: tuple[float, float] = quantity(
        "m", 0.05, 1e6, default=(0.6, 1.5), doc="between commanded halts"
    )
    halt_time: float = quantity("s", 0.0, 1e3, default=0.9, doc="length of a halt; 0 = none")
    classes: int = quantity(
        "", 0, MOST_CLASSES, default=0, doc="terrain classes; 0 = a soil of its own for each patch"
    )
    class_scatter: float = quantity(
        "of spread", 0.0, 1.0, default=0.2, doc="of the patches of a class about its soil"
    )
    lines: int = quantity(
        "", 1, 2, default=1, doc="routes over a patch between which the wheel may choose"
    )
    halt_before: tuple[float, float] = quantity(
        "m", 0.0, 1e3, default=(0.4, 0.7), doc="a patch with two routes"
    )

    def _check_together(self) -> None:
        """Raise `FieldError` for a border longer than the shortest patch or slope, and for two
        routes that `_check_lines` refuses.
        """
        for piece, shortest in (("patch", self.patch_length[0]), ("slope", self.slope_length[0])):
            if self.border > shortest:
                raise FieldError(
                    self,
                    "border",
                    f" = {self.border}: expected at most the shortest {piece}, {shortest} m",
                )
        if self.lines > 1:
            self._check_lines()

    def _check_lines(self) -> None:
        """Raise `FieldError` where two routes have fewer than two classes, or no halts to choose a
        route in.

        Raise it also where `halt_before` is not within the shortest patch, a border away from each
        of its ends.
        """
        if self.classes < 2:
            raise FieldError(
                self, "classes", f" = {self.classes}: expected at least 2 where lines = 2"
            )
        if self.halt_time == 0.0:
            raise FieldError(
                self, "halt_time", " = 0: expected halts where lines = 2, to choose a route in"
            )
        low, high = self.halt_before
        most = self.patch_length[0] - self.border
        if low < self.border or high > most + _ROUNDING:
            raise FieldError(
                self,
                "halt_before",
                f" = {self.halt_before}: expected between the border, {self.border} m, and the "
                f"shortest patch less the border, {most:g} m; a shorter border leaves more",
            )


@dataclass(frozen=True)
class Camera(Checked):
    """Camera on the rover, which sees the ground ahead if that has terrain classes.

    It sees the class of each route, which is wrong with probability `label_error`, the grade, and
    how far off the border is. Label and grade of a patch are read from its look: they are wrong in
    the same way in every image. The distance has one error that stays for a patch and one that is
    new in every image, both with the standard deviation `border_noise`.
    """

    range: float = quantity("m", 0.1, 100.0, default=2.0)
    label_error: float = quantity(
        "", 0.0, 1.0, default=0.05, doc="probability of another class than the true one"
    )
    grade_noise: float = quantity("rad", 0.0, 1.0, default=0.01)
    border_noise: float = quantity("m", 0.0, 1.0, default=0.03)
