"""Named effects that the base model of Eqs. (1)-(10) lacks: equation, parameters and source of each.

So far the one that the simulated world cannot do without: slip-sinkage. The balance (1) alone gives *less* sinkage at
more slip; real wheels dig.
"""

from __future__ import annotations

from soil_env.compiled import inlined, kernel


@kernel
def slip_sinkage_ratio(slip, gain, recovery):
    """Steady sinkage over the sinkage of the same load on undisturbed soil: 1 + gain |i| / (1 - |i| + recovery |i|).

    gain = 1.5 and recovery = 0.5 give (1 + i)/(1 - 0.5 i) of Lyasko (2010), J. Terramechanics 47(1):21-31;
    recovery = 0 gives the i/(1 - i) law of Reece for the soil a wheel excavates. For a braked wheel the digging is
    driven by the share |i| of its travel that it slides: 1 + gain |i| / (1 + recovery |i|).

    Both are the steady states of `excavation_rate`.
    """
    if slip >= 0.0:
        return 1.0 + gain * slip / max(1.0 - slip + recovery * slip, 1e-6)
    return 1.0 - gain * slip / (1.0 - recovery * slip)


@inlined
def excavation_rate(travel_speed, slip_speed, gain, recovery, length):
    """Coefficients (A, B) [1/s] of the sinkage law dz/dt = B z_w - A z.

    z_w [m] is the depth of undisturbed soil that carries the load. With travel |V| the wheel moves onto fresh soil
    and z relaxes to z_w over the distance `length` [m]; the sliding speed |r w - V| carries soil away from under the
    rim (`gain`), more slowly the deeper the hole, since its walls flow back (`recovery`):

        dz/dt = { |V| (z_w - z) + |r w - V| [gain z_w - recovery (z - z_w)] } / length
    """
    a = (travel_speed + recovery * slip_speed) / length
    b = (travel_speed + (gain + recovery) * slip_speed) / length
    return a, b
