"""Controllers that limit the slip to that of the best drawbar pull, on the identified or the true soil."""

from __future__ import annotations

import numpy as np

from soil_env.terramechanics.traversability import best_points

from .slip import SlipFollower

CHANGE = np.array([0.01] * 7 + [0.1])  # relative change of soil and load that recomputes the best slip


class BestSlipIdentified(SlipFollower):
    """A ramp of the rim speed, limited to the slip of the best steady drawbar pull on the soil as identified."""

    name = "best_slip_identified"
    variant = "identified"
    memory = {**SlipFollower.memory, "known": 8, "slip": 0}

    def soil_columns(self, observation) -> list:
        """The columns of `SoilState` read from the observation, each [n] or one number."""
        read, belief = (lambda name: observation[:, self.column[name]]), self.scenario.belief
        return [
            np.tan(np.clip(read("friction_angle"), 0.02, 1.4)),
            1000.0 * read("cohesion"),
            10.0 ** read("log10_shear_modulus"),
            10.0 ** read("log10_sinkage_coefficient"),
            belief.sinkage_exponent,
            read("dig_gain"),
            belief.dig_recovery,
        ]

    def soils(self, observation) -> np.ndarray:
        """`SoilState` rows [n, 7] read from the observation."""
        return np.column_stack([np.broadcast_to(x, len(observation)) for x in self.soil_columns(observation)])

    def load(self, observation) -> np.ndarray:
        """Load [N] read from the observation, [n]."""
        return np.clip(observation[:, self.column["load"]], 0.3, 3.0) * self.scenario.weight

    def target_slip(self, observation, state):
        """Best slip; computed again only for rows whose soil has changed by more than 1 % or whose load by 10 %."""
        soils, load = self.soils(observation), self.load(observation)
        known, now = state["known"], np.column_stack([soils, load])
        rows = np.flatnonzero((np.abs(now - known) > CHANGE * np.abs(known)).any(axis=1))
        wheel = self.scenario.wheel
        best_points(
            rows, soils, load, wheel.radius, wheel.width, wheel.stall_torque, state["slip"], np.empty(len(load))
        )
        known[rows] = now[rows]
        return state["slip"]


class BestSlipTrue(BestSlipIdentified):
    """The same on the true soil."""

    name = "best_slip_true"
    variant = "true_soil"

    def soil_columns(self, observation):
        """The columns of `SoilState` read from the observation, each [n]."""
        out = super().soil_columns(observation)
        for i, name in ((4, "sinkage_exponent"), (6, "dig_recovery")):
            out[i] = observation[:, self.column[name]]
        return out
