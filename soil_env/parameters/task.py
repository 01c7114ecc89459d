"""Action, limits and reward of a task."""

from dataclasses import dataclass
from typing import Literal

from soil_env._io.loading import Checked, quantity

#: Control periods that an action lasts unless `Control.repeat` says otherwise.
ACTION_PERIODS = {"torque": 1, "wheel_speed": 1, "rim_acceleration": 5}


@dataclass(frozen=True)
class Limits(Checked):
    """Thresholds beyond which a wheel counts as immobilised (see `task.Cause`)."""

    no_progress_distance: float = quantity("m", 1e-3, 1e3, default=0.1)
    no_progress_time: float = quantity(
        "s", 0.1, 1e3, default=10.0, doc="to get that much further, halts left out"
    )
    stalled_rim_speed: float = quantity(
        "m/s", 1e-4, 1.0, default=0.01, doc="below it the wheel counts as not turning"
    )
    bogged_sinkage: float = quantity("of radius", 0.05, 1.4, default=0.8)


@dataclass(frozen=True)
class RewardWeights(Checked):
    """Weights of the reward terms: of `task.rules.judge_period`, and of what the identifier learns
    (`information`).
    """

    progress: float = quantity("per course", 0.0, 1e4, default=10.0)
    energy: float = quantity("per weight x course length", 0.0, 1e4, default=1.0)
    immobilisation: float = quantity(
        "", 0.0, 1e4, default=10.0, doc="cost of it, and of the time limit"
    )
    information: float = quantity("per nat", 0.0, 1e4, default=0.0)
    information_discount: float = quantity(
        "a step", 0.0, 1.0, default=0.999, doc="the agent's own discount"
    )


@dataclass(frozen=True)
class Control(Checked):
    """Action of the agent, control period, integrator step and time limit.

    `repeat` is the number of control periods that an action lasts; where it is not given,
    `ACTION_PERIODS[action]`.
    """

    period: float = quantity("s", 1e-3, 1.0, default=0.1, doc="of sensors, identifier and drive")
    substep: float = quantity("s", 1e-4, 0.5, default=0.1, doc="longest step of the integrator")
    time_limit: float = quantity("s", 1.0, 1e5, default=90.0, doc="time to finish the course in")
    action: Literal["torque", "wheel_speed", "rim_acceleration"] = "rim_acceleration"
    rim_acceleration: float = quantity(
        "m/s2", 1e-3, 1e3, default=0.3, doc="of the commanded rim, action 1 or -1"
    )
    halt_deceleration: float = quantity(
        "m/s2", 1e-3, 1e6, default=1.0, doc="of the commanded rim at a halt"
    )
    repeat: int | None = quantity("control periods", 1, 1e5, default=None)

    @property
    def action_periods(self) -> int:
        """Control periods that an action lasts."""
        return ACTION_PERIODS[self.action] if self.repeat is None else self.repeat

    @property
    def duration(self) -> float:
        """Time that an action lasts [s]."""
        return self.period * self.action_periods
