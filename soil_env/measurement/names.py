"""Names that columns have elsewhere: which column of a measurement table is meant."""

import re
from collections.abc import Collection

from soil_env._io.loading import nearest

#: What a column holds, in words, and its names in papers, logs and rigs (Wong 2008; ISO 8855 with x
#: ahead and z up).
OTHERS = {
    "slip": (
        "a share, 1 - V/(r w) where the wheel drives",
        "slip_ratio slip_rate slippage wheel_slip longitudinal_slip skid s i",
    ),
    "load": (
        "N on the wheel, positive; 9.81 times a mass in kg",
        "fz force_z normal_load vertical_load wheel_load axle_load normal_force vertical_force "
        "weight mass force f w m",
    ),
    "sinkage": (
        "m below the surface",
        "z depth sink wheel_sinkage sinkage_depth penetration entrance_sinkage",
    ),
    "drawbar_pull": (
        "N at the axle, thrust less resistance, positive where the wheel pulls",
        "pull dp f_dp fdp dbp drawbar drawbar_force draw_bar_pull fx force_x pull_force "
        "pulling_force horizontal_force longitudinal_force net_traction tractive_force thrust "
        "gross_traction force f",
    ),
    "torque": (
        "N m about the axle, positive where it drives",
        "my moment moment_y mx moment_x mz wheel_torque drive_torque driving_torque motor_torque "
        "axle_torque t m",
    ),
    "speed": (
        "m/s of travel; that of the rim is in the slip",
        "v vx velocity travel_speed travel_velocity forward_speed linear_speed linear_velocity "
        "ground_speed carriage_speed omega rpm angular_velocity angular_speed wheel_speed "
        "rotational_speed rim_speed wheel_velocity wheel_omega w",
    ),
    "pass": ("1 on fresh soil", "passes pass_number n_pass passage"),
    "grade_deg": ("degrees, positive uphill", "grade slope slope_angle inclination incline"),
    "time": ("s from any start", "timestamp t date datetime date_time"),
    "run": ("a name or number", "test trial experiment run_id test_id"),
    "wheel_radius": ("m, half the diameter", "radius r diameter wheel_diameter"),
    "wheel_width": ("m", "width b"),
    "grouser_height": ("m", "grouser lug_height grousers lugs"),
}
#: Units that others write at the end of a name, as in `sinkage_mm`.
UNITS = "mm cm m km n kn kg kgf nm nmm ncm knm pct percent deg rad s ms h mps kmh".split()


def meant(name: str, header: Collection[str], known: Collection[str]) -> str:
    """Hint '; did you mean ...?' for the unknown column `name` of a table with this `header`.

    Units at the end of the name are ignored. A name in `OTHERS` gives the columns that it may
    stand for and what they hold; "" where the header has them all already. Any other name is
    compared with the `known` ones by its spelling; "" where none is like it.
    """
    words = re.findall(r"[a-z0-9]+", name.lower())
    while len(words) > 1 and words[-1] in UNITS:
        words.pop()
    bare = "_".join(words)
    written = {bare, "".join(words)}
    like = [column for column, (_, names) in OTHERS.items() if written & {column, *names.split()}]
    if not like:
        return nearest(bare, known)
    left = [f"{column!r} ({OTHERS[column][0]})" for column in like if column not in header]
    return f"; did you mean {' or '.join(left)}?" if left else ""
