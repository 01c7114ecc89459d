"""View of the first course of a simulation: canvas, window, and the history that charts show."""

import math
from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np

from soil_env.parameters import Scenario

from .canvas import SIZE, Canvas
from .charts import QUANTITIES, SPAN, draw_charts
from .ground import draw_course, friction_range, profile_of
from .side_view import COLOURS, draw_side_view, draw_table, sample_of, shown_wheels, width_of

if TYPE_CHECKING:
    import pygame

_POINTS = 600  # intervals between samples of the history over the `SPAN` of the charts, at most


class CourseView:
    """Draws the first course of a simulation of wheels or rovers: `clear` at a reset, `record`
    after it and after each step, `draw` a frame.

    `mode`: "rgb_array" returns pictures, "human" shows them in a window.
    """

    def __init__(self, scenario: Scenario, mode: str) -> None:
        self.scenario = scenario
        self.mode = mode
        self._canvas: Canvas | None = None
        self._window: pygame.Window | None = None
        self._clock: pygame.time.Clock | None = None
        self._step = scenario.control.duration  # [s] from record to record
        self._every = max(1, math.ceil(SPAN / self._step / _POINTS))  # records per sample
        # `_POINTS` intervals have one sample more; one is spare, for rounding.
        self._history: deque[list[float]] = deque(maxlen=_POINTS + 2)
        self._angles: Any = 0.0  # [rad] that the wheels have turned

    def clear(self) -> None:
        """Forget the history and the angles of the wheels, for a new episode."""
        self._history.clear()
        self._angles = 0.0

    def record(self, simulation: Any) -> None:
        """Turn the wheels in the picture as far as their present speeds turn them in an action, and
        add the state of the vehicle to the history. After a reset the speeds are 0.

        Only every `_every`-th state is added, so that `_POINTS` intervals cover the charts. The
        last state of an episode that ends in the middle of an action is left out.
        """
        steps = simulation.steps[0]
        wheels = shown_wheels(simulation)
        self._angles = self._angles + np.array([w["wheel_speed"] for w in wheels]) * self._step
        if steps % (self._every * self.scenario.control.action_periods) == 0:
            sample = [steps * self.scenario.control.period]
            for w in wheels:
                sample += sample_of(simulation, w)
            self._history.append(sample)

    def draw(self, simulation: Any) -> np.ndarray | None:
        """Picture of the vehicle as uint8 [height, width, 3]; in mode "human" it goes to the
        window, and None is returned.
        """
        canvas = self._canvas or Canvas()
        self._canvas = canvas
        canvas.clear()
        simulation.complete(0)  # all of its course is drawn from the soils
        wheels = shown_wheels(simulation)
        width = width_of(simulation)
        course = self.scenario.course
        beyond = course.length + 2.0 * width
        profile = profile_of(simulation.worlds.courses, course.border, width, beyond)
        bounds = friction_range(simulation)
        angles = np.broadcast_to(self._angles, len(wheels))  # 0 before the first record
        draw_side_view(canvas, simulation, wheels, profile, bounds, angles)
        draw_table(canvas, wheels, bounds)
        draw_course(canvas, profile, course.length, [w["x"] for w in wheels], bounds)
        colours = [COLOURS[w["name"]] for w in wheels]
        history = np.reshape(self._history, (-1, 1 + QUANTITIES * len(wheels))).T
        draw_charts(canvas, history, colours, identified=wheels[0]["status"] is not None)
        surface = canvas.finish()
        if self.mode == "human":
            self._show(surface)
            return None
        import pygame

        return pygame.surfarray.array3d(surface).swapaxes(0, 1).copy()

    def close(self) -> None:
        """Close the window, if there is one, and free the surfaces."""
        if self._window is not None:
            self._window.destroy()
        self._window = None
        self._canvas = None
        self._clock = None

    def _show(self, surface: Any) -> None:
        """Put a picture into the window, which is opened at the first call.

        Waits until a step of real time has passed since the last picture.
        """
        import pygame

        if self._window is None or self._clock is None:
            pygame.display.init()
            self._window = pygame.Window(f"soil_env: {self.scenario.name}", SIZE)
            self._clock = pygame.time.Clock()
        pygame.event.pump()
        self._window.get_surface().blit(surface, (0, 0))
        self._window.flip()
        self._clock.tick(1.0 / self._step)
