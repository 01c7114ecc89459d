"""A rover seen from the side: where its axles and its centre of mass are."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

from soil_env._io.loading import Checked, FieldError, quantity

MOST_AXLES = 3  # [-] two fixed to the body, or three with a bogie
LEAST_SHARE = 0.02  # [-] of the weight that an axle carries, for the rover not to tip; own choice


@dataclass(frozen=True)
class Vehicle(Checked):
    """Masses and lengths of a rover whose two sides are alike: two wheels an axle.

    Lengths are measured along the body from the front axle backwards, heights from the line of the
    axles upwards. There are two or three axles. Two are fixed to the body. Of three, two hang on a
    bogie that turns freely about its pivot, as in a rocker-bogie suspension. Then the load of each
    wheel follows from the equilibrium of bogie and body.
    """

    mass: float = quantity("kg", 0.6, 4e5, doc="of the whole rover, without payload")
    axles: tuple[float, ...] = quantity(
        "m", 0.0, 100.0, doc="behind the front axle, which is the first, at 0"
    )
    centre: float = quantity("m", 0.0, 100.0, doc="centre of mass, behind the front axle")
    centre_height: float = quantity("m", -10.0, 100.0, doc="centre of mass, above the axles")
    bogie: Literal["none", "front", "rear"] = "none"
    pivot: float = quantity("m", 0.0, 100.0, default=0.0, doc="of the bogie, behind the front axle")
    pivot_height: float = quantity(
        "m", -10.0, 100.0, default=0.0, doc="of the bogie, above the axles"
    )
    source: str = ""

    def _check_together(self) -> None:
        """Raise `FieldError` unless there are two axles without a bogie or three with one, in order
        from 0.

        Raise it also for a pivot that is not between the axles of the bogie, and where an axle
        carries less than `LEAST_SHARE`.
        """
        count = len(self.axles)
        given = f" = {self.axles!r}"
        if not 2 <= count <= MOST_AXLES:
            raise FieldError(self, "axles", f"{given}: expected 2 or 3 axles")
        if self.axles[0] != 0.0 or self.nearest <= 0.0:
            raise FieldError(
                self,
                "axles",
                f"{given}: expected metres behind the front axle, front to rear: 0 first, each "
                "larger than the last",
            )
        if (self.bogie == "none") != (count == 2):
            known = "'none' with two axles" if count == 2 else "'front' or 'rear' with three axles"
            raise FieldError(self, "bogie", f" = {self.bogie!r}: expected {known}")
        if self.bogie != "none":
            low, high = self.axles[self.first_on_bogie : self.first_on_bogie + 2]
            if not low < self.pivot < high:
                expected = f"expected between the axles of the bogie, {low} and {high}"
                raise FieldError(self, "pivot", f" = {self.pivot}: {expected}")
        if min(self.shares) < LEAST_SHARE:
            carried = ", ".join(f"{s:.3g}" for s in self.shares)
            pivot = "" if self.bogie == "none" else f" with pivot = {self.pivot:g}"
            raise FieldError(
                self,
                "centre",
                f" = {self.centre}: expected between the axles, so that each carries at least "
                f"{100 * LEAST_SHARE:g} % of the weight; they carry {carried}{pivot}",
            )

    @property
    def first_on_bogie(self) -> int:
        """Index of the front one of the two axles of the bogie; -1 without a bogie."""
        return {"none": -1, "front": 0, "rear": 1}[self.bogie]

    @property
    def base(self) -> float:
        """Distance from the front axle to the rear one [m]."""
        return self.axles[-1]

    @property
    def nearest(self) -> float:
        """Least distance from an axle to the one behind it [m]."""
        return min(behind - axle for axle, behind in pairwise(self.axles))

    @property
    def shares(self) -> tuple[float, ...]:
        """Share of the weight that each axle carries at rest on level ground, front to rear; the
        shares add up to 1. One is below 0 where the rover would tip, which construction refuses.
        """
        if self.bogie == "none":
            rear = self.centre / self.base
            return 1.0 - rear, rear
        first = self.first_on_bogie
        fixed = self.axles[2 if self.bogie == "front" else 0]
        low, high = self.axles[first : first + 2]
        # share of the axle that is not on the bogie, by moments about the pivot
        alone = (self.pivot - self.centre) / (self.pivot - fixed)
        on_rear = (self.pivot - low) / (high - low)  # of the load of the bogie
        pair = ((1.0 - alone) * (1.0 - on_rear), (1.0 - alone) * on_rear)
        return (*pair, alone) if self.bogie == "front" else (alone, *pair)


def mass_of_wheel(vehicle: Vehicle) -> float:
    """Mass [kg] of the vehicle over its number of wheels."""
    return vehicle.mass / (2 * len(vehicle.axles))
