"""Controllers of a wheel: without knowledge of the ground, by slip alone, and by the best slip on
its soil.
"""

import numpy as np

from soil_env.parameters import FLOW_LAW, SoilState
from soil_env.slip import rim_speeds, travel_speeds
from soil_env.terramechanics.traversability import best_points

from .base import SPEED, START, Controller, Ramped, Setting

MOST_SLIP = 0.95  # largest slip to hold: the rim speed for a slip i is V/(1 - i)
_LEAD = 0.2  # [of the starting speed] by which the rim leads V/(1 - i), so that speed can build up
_SLIP = Setting(0.3, "-", "slip to hold, or not to exceed", (0.02, 0.9), high=MOST_SLIP, zero=True)
#: Relative changes of the entries of `SoilState` and of the load that recompute the best slip.
CHANGE = np.array([0.01] * len(SoilState._fields) + [0.1])


class FullThrottle(Controller):
    """Full command, always."""

    name = "full_throttle"

    def _answer(self, batch, state, fresh, deterministic):
        """The setting `share`, 1 without one, for each observation, and the `state` as it is."""
        share = self.settings.get("share", 1.0)
        return np.full((len(batch), 1), share, dtype=np.float32), state


class ConstantTorque(FullThrottle):
    """A constant command, as a share of the largest action."""

    name = "constant_torque"
    bounds = {"share": Setting(0.4, "of the highest action", "the command", (0.05, 1.0), high=1.0)}


class BestRoute(Controller):
    """A constant command, on the route with the larger margin of pull on the soil as identified."""

    name = "best_route"
    variant = "identified"
    bounds = {"share": ConstantTorque.bounds["share"]._replace(default=0.3)}

    def act(self, batch, state):
        """The setting `share` as the action, [n, 1]; at the halts before a fork its sign chooses
        the route (`chosen`).
        """
        share = np.full((len(batch), 1), self.settings["share"], dtype=np.float32)
        return self.chosen(batch, share, self.prefers_other_route(batch))


class ConstantSpeed(Controller):
    """A constant rim speed."""

    name = "constant_speed"
    bounds = {"speed": SPEED._replace(default=0.33)}

    def rim_speed(self, observation, state):
        """The setting `speed` [m/s], [n]."""
        return np.full(len(observation), self.settings["speed"])


class SoftStart(Ramped):
    """A rim speed that rises evenly from rest, and after every halt, up to a top speed."""

    name = "soft_start"
    bounds = {**Ramped.bounds, "speed": SPEED._replace(default=0.6)}

    def rim_speed(self, observation, state):
        """The ramp [m/s], [n], by the settings."""
        return self.ramp(observation, state, self.settings["acceleration"], self.settings["speed"])


class SlipFollower(Ramped):
    """Base: the rim speed V/(1 - i) of a target slip i, or that of the ramp where it is lower."""

    bounds = {"start": START, **Ramped.bounds}

    def target_slip(self, observation, state):
        """Slip not to exceed, [n]."""
        raise NotImplementedError

    def rim_speed(self, observation, state):
        """Rim speed [m/s], [n]: V/(1 - i) plus a lead, at least the setting `start`, at most the
        ramp.

        i is the `target_slip`, at most `MOST_SLIP`; the lead is `_LEAD` times `start`.
        """
        ramp = self.ramp(observation, state, self.settings["acceleration"], self.settings["speed"])
        slip, rim = (observation[:, self.column[name]] for name in ("slip", "rim_speed"))
        # V from slip and rim speed is less noisy at low speeds than the speed sensor. Near a slip
        # of -1, of a locked wheel, it would be too large.
        travel = travel_speeds(np.maximum(rim, 0.0) * self.top_speed, np.maximum(slip, -0.9))
        target = np.minimum(self.target_slip(observation, state), MOST_SLIP)
        start = self.settings["start"]
        return np.minimum(np.maximum(rim_speeds(travel, target) + _LEAD * start, start), ramp)


class FixedSlip(Controller):
    """A rim speed whose acceleration holds a slip, from a creeping start up to a top speed.

    A wheel that gains speed needs more pull than the slope alone, and so has more slip. So the slip
    is held by the acceleration of the rim, as long as the rim speed is between `start` and `speed`.
    """

    name = "fixed_slip"
    bounds = {
        "slip": _SLIP,
        "start": START._replace(default=0.04, tuned=(0.01, 0.15)),
        "speed": SPEED,
    }
    memory = {**Controller.memory, "rim": 0, "gain": 0}
    step = 1.5  # [m/s2] change of the acceleration per action and unit of slip
    most = 1.0  # [m/s2] largest acceleration of the rim, and largest deceleration

    def rim_speed(self, observation, state):
        """Rim speed [m/s], [n]: the last one, at least `start`, plus its change in an action, cut
        to [`start`, `speed`]; 0 at a halt.

        Keeps `rim`, the rim speed [m/s], and `gain`, its acceleration [m/s2], in `state`.
        """
        start = self.settings["start"]
        top = self.settings["speed"]
        error = self.settings["slip"] - observation[:, self.column["slip"]]
        rest = self.halted(observation)
        gain = np.clip(  # [m/s2] acceleration of the rim
            np.where(rest, 0.0, state["gain"] + self.step * error), -self.most, self.most
        )
        rim = np.where(rest, 0.0, np.maximum(state["rim"], start)) + gain * self.period
        state["rim"] = np.where(rest, 0.0, np.clip(rim, start, max(top, start)))
        # At its limits the acceleration does not wind up.
        held = np.where(rim > top, np.minimum(gain, 0.0), gain)
        state["gain"] = np.where(rim < start, np.maximum(held, 0.0), held)
        return state["rim"]


class SlipLimiter(SlipFollower):
    """A ramp of the rim speed that waits where the slip reaches its limit."""

    name = "slip_limiter"
    bounds = {"slip": _SLIP._replace(default=0.5, tuned=(0.05, 0.9)), **SlipFollower.bounds}

    def target_slip(self, observation, state):
        """The setting `slip`, [n]."""
        return np.full(len(observation), self.settings["slip"])


class ExtremumSeeking(SlipFollower):
    """A limit of the slip that seeks the highest drawbar pull.

    The limit swings about an estimate of the best slip. The estimate climbs the slope of the
    measured pull over the measured slip, a regression over the last seconds.
    """

    name = "extremum_seeking"
    bounds = {
        "gain": Setting(
            0.3, "1/s", "of the estimate by the slope of the pull", (0.01, 3.0), True, high=1e3
        ),
        "swing": Setting(
            0.05, "-", "amplitude of the slip about its estimate", (0.01, 0.15), high=0.3
        ),
        **SlipFollower.bounds,
    }
    memory = {
        **SlipFollower.memory,
        "best": 0,
        "phase": 0,
        "slip_mean": 0,
        "pull_mean": 0,
        "power": 0,
        "product": 0,
    }
    first = 0.3  # estimate at the start
    low = 0.05  # least estimate
    high = 0.8  # largest estimate
    swing_period = 1.2  # [s], unless actions last more than half a second
    samples = 2.4  # actions in a swing, at least: with two or fewer it would be seen as another
    swings = 2.0  # in which the means and the slope are formed
    _LITTLE = 1e-3  # variance of slip at which the slope counts half: that of its sensor is 1e-4

    def __init__(self, scenario, **settings):
        super().__init__(scenario, **settings)
        self.swing_period = max(self.swing_period, self.samples * self.period)

    def target_slip(self, observation, state):
        """Limit of the slip, [n]: the estimate of the best slip, plus its swing; advances both.

        Means and estimate stand still in a halt. The means begin at 0, the slip and about the pull
        of a wheel at rest.
        """
        driving = ~(self.halted(observation) | state["fresh"])
        slip, pull = (observation[:, self.column[name]] for name in ("slip", "drawbar_pull"))
        newest = self.period / (self.swings * self.swing_period)  # its weight
        share = np.where(driving, newest, 0.0)
        a = slip - state["slip_mean"]
        b = pull - state["pull_mean"]
        # Means, variance of the slip (power) and its covariance with the pull (product).
        state["slip_mean"] = state["slip_mean"] + share * a
        state["pull_mean"] = state["pull_mean"] + share * b
        state["power"] = state["power"] + share * (a * a - state["power"])
        state["product"] = state["product"] + share * (a * b - state["product"])
        slope = state["product"] / (state["power"] + self._LITTLE)
        best = np.where(state["fresh"], self.first, state["best"])
        step = np.where(driving, self.settings["gain"] * self.period * slope, 0.0)
        state["best"] = np.clip(best + step, self.low, self.high)
        state["phase"] = state["phase"] + 2.0 * np.pi / self.swing_period * self.period
        return state["best"] + self.settings["swing"] * np.sin(state["phase"])


class BestSlipIdentified(SlipFollower):
    """A ramp of the rim speed, limited to the slip of the best steady drawbar pull on the soil as
    identified.
    """

    name = "best_slip_identified"
    variant = "identified"
    memory = {**SlipFollower.memory, "known": len(SoilState._fields) + 1, "slip": 0}

    def soil_columns(self, observation) -> SoilState:
        """Soils read from the observation, the rest from the belief, in the units of `SoilState`:
        each entry an array [n] or one number.
        """

        def read(name: str):
            """Values of an entry of the observations, [n]."""
            return observation[:, self.column[name]]

        belief = self.scenario.belief
        return SoilState(
            tan_phi=np.tan(np.clip(read("friction_angle"), 0.02, 1.4)),  # above 0 and finite
            cohesion=1000.0 * read("cohesion"),  # observed in kPa
            shear_modulus=10.0 ** read("log10_shear_modulus"),
            sinkage_coefficient=10.0 ** read("log10_sinkage_coefficient"),
            sinkage_exponent=belief.sinkage_exponent,
            dig_gain=read("dig_gain"),
            dig_recovery=belief.dig_recovery,
            **{name: getattr(belief, name) for name in FLOW_LAW},
        )

    def soils(self, observation) -> np.ndarray:
        """`soil_columns` as rows [n, entries of `SoilState`]."""
        return np.column_stack(
            [np.broadcast_to(x, len(observation)) for x in self.soil_columns(observation)]
        )

    def load(self, observation) -> np.ndarray:
        """Load [N] read from the observation, cut to between 0.3 and 3 weights, [n]."""
        return np.clip(observation[:, self.column["load"]], 0.3, 3.0) * self.scenario.weight

    def target_slip(self, observation, state):
        """Slip [n] of the highest steady pull that the motor can hold on the soil (`best_points`).

        Kept in `state` with the soil and load that it was computed for, and computed again only for
        rows where one of these has changed by more than `CHANGE`.
        """
        soils = self.soils(observation)
        load = self.load(observation)
        known = state["known"]  # [n, entries + 1] soil and load of the slip that is kept
        now = np.column_stack([soils, load])
        rows = np.flatnonzero((np.abs(now - known) > CHANGE * np.abs(known)).any(axis=1))
        state["slip"][rows] = best_points(soils[rows], load[rows], self.scenario.wheel)[0]
        known[rows] = now[rows]
        return state["slip"]


class BestSlipTrue(BestSlipIdentified):
    """`BestSlipIdentified` on the true soil."""

    name = "best_slip_true"
    variant = "true_soil"

    def soil_columns(self, observation):
        """True soils, read from the observation; only the entries `FLOW_LAW` are the belief's."""
        read_too = ("sinkage_exponent", "dig_recovery")
        true = {name: observation[:, self.column[name]] for name in read_too}
        return super().soil_columns(observation)._replace(**true)
