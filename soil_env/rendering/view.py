"""Common base of the views of a course: canvas, window, and the history that charts show."""

import math
from abc import ABC, abstractmethod
from collections import deque
from typing import Any, ClassVar

import numpy as np

from soil_env.identification import Status
from soil_env.parameters import Scenario
from soil_env.rendering.canvas import DESIGN, Canvas
from soil_env.rendering.charts import SPAN
from soil_env.rendering.ground import Profile, profile_of

MODES = ("rgb_array", "human")
_POINTS = 600  # of the history, at most


class CourseView(ABC):
    """Draws one course of a simulation: `record` after each reset and step, `draw` whenever a frame is due."""

    _windows: ClassVar[set[int]] = set()  # ids of the open windows of all views, which share one event queue

    def __init__(self, scenario: Scenario, mode: str, size: tuple[int, int] = DESIGN) -> None:
        if mode not in MODES:
            raise ValueError(f"render mode {mode!r}: expected one of {', '.join(MODES)}")
        self.scenario: Scenario = scenario
        self.mode: str = mode
        self.size: tuple[int, int] = (size[0], size[1])
        self._canvas = self._window = self._clock = None
        self._course_key = self._profile = None
        self._step = scenario.control.duration  # [s] from record to record
        self._identified = scenario.belief.method != "none"  # else there is no estimate to show
        self._every = max(1, math.ceil(SPAN / self._step / _POINTS))  # records per sample
        self._history: deque[tuple] = deque(maxlen=_POINTS + 2)
        self._angles: Any = 0.0  # [rad] that the wheels have turned

    def clear(self) -> None:
        """Forget the history: a new episode."""
        self._history.clear()
        self._angles = 0.0

    def record(self, simulation: Any, k: int) -> None:
        """Add the present state of number k to the history; at its reset the history starts anew."""
        steps, wheel_speed = self._motion(simulation, k)
        if steps == 0:
            self.clear()
        self._angles = self._angles + wheel_speed * self._step
        if steps % (self._every * self.scenario.control.held) == 0:
            self._history.append((steps * simulation.numbers.world.period, *self._sample(simulation, k)))

    @abstractmethod
    def _motion(self, simulation: Any, k: int) -> tuple[int, Any]:
        """Control periods since the reset, and the speed of each wheel [rad/s]."""

    @abstractmethod
    def _sample(self, simulation: Any, k: int) -> tuple[float, ...]:
        """Numbers of the charts now."""

    def _status(self, known: Any, k: int) -> str:
        """The word for the status of the identifier of wheel k; "none" where there is none."""
        return Status(int(known.status[k])).name.lower().replace("_", " ") if self._shows(known) else "none"

    def _shows(self, known: Any) -> bool:
        """True if there is an estimate to show."""
        return self._identified and known is not None

    @abstractmethod
    def _paint(self, canvas: Canvas, simulation: Any, k: int) -> None:
        """Draw number k as it is now on a cleared canvas; its course is complete."""

    def draw(self, simulation: Any, k: int) -> np.ndarray | None:
        """The picture as uint8 [height, width, 3] in mode "rgb_array"; in mode "human" it goes to the window."""
        if self.mode == "human" and not self._poll():
            return None
        self._canvas = self._canvas or Canvas(self.size)
        self._canvas.clear()
        simulation.complete(k)
        self._paint(self._canvas, simulation, k)
        surface = self._canvas.finish()
        if self.mode == "human":
            self._window.get_surface().blit(surface, (0, 0))
            self._window.flip()
            self._clock.tick(1.0 / self._step)
            return None
        import pygame

        return np.frombuffer(pygame.image.tobytes(surface, "RGB"), np.uint8).reshape(*self.size[::-1], 3).copy()

    def close(self) -> None:
        """Close the window, if there is one, and free the surfaces."""
        if self._window is not None and self._id in self._windows:
            self._windows.discard(self._id)
            self._window.destroy()
        self._window = self._canvas = self._clock = None

    def _ground(self, simulation: Any, k: int, before: float, beyond: float, level: bool) -> Profile:
        """`profile_of` course k, computed anew where the course is another one."""
        courses = simulation.worlds.courses
        key = courses.edges[k].tobytes() + courses.soils[k].tobytes() + courses.grades[k].tobytes()
        if key != self._course_key:
            self._profile = profile_of(courses, k, simulation.numbers.world.border, before, beyond, level)
            self._course_key = key
        return self._profile

    def _poll(self) -> bool:
        """Open the window at the first call and handle its events; False once the user has closed it."""
        import pygame

        if self._window is None:
            pygame.display.init()
            self._window, self._clock = pygame.Window(f"soil_env: {self.scenario.name}", self.size), pygame.time.Clock()
            self._id = self._window.id
            self._windows.add(self._id)
        for event in pygame.event.get():
            if event.type == pygame.WINDOWCLOSE and event.window is not None and event.window.id in self._windows:
                self._windows.discard(event.window.id)
                event.window.destroy()
        return self._id in self._windows
