"""Names that columns have elsewhere: which column of a measurement table is meant, and its unit."""

import re
from collections.abc import Collection

from soil_env._io.loading import nearest

#: What a column has to hold, in words.
MEANT = {
    "slip": "a share, 1 - V/(r w) where the wheel drives",
    "load": "N on the wheel, positive",
    "sinkage": "m below the surface",
    "drawbar_pull": "N, positive where the wheel pulls",
    "torque": "N m about the axle, positive where it drives",
    "speed": "m/s of travel",
    "pass": "1 on fresh soil",
    "grade_deg": "degrees, positive uphill",
    "time": "s",
    "run": "a name or number",
    "wheel_radius": "m",
    "wheel_width": "m",
    "grouser_height": "m",
}
#: Names in papers, logs and rigs (Wong 2008; ISO 8855 with x ahead and z up).
OTHER_NAMES = {
    "slip": "slip_ratio slip_rate slippage wheel_slip longitudinal_slip skid s i",
    "load": "fz force_z normal_load vertical_load wheel_load axle_load normal_force vertical_force "
    "weight",
    "sinkage": "z depth sink wheel_sinkage sinkage_depth penetration entrance_sinkage",
    "drawbar_pull": "pull dp f_dp fdp dbp drawbar drawbar_force draw_bar_pull fx force_x "
    "pull_force pulling_force horizontal_force longitudinal_force net_traction tractive_force",
    "torque": "my moment moment_y wheel_torque drive_torque driving_torque motor_torque "
    "axle_torque",
    "speed": "v vx velocity travel_speed travel_velocity forward_speed linear_speed "
    "linear_velocity ground_speed carriage_speed",
    "pass": "passes pass_number n_pass passage",
    "grade_deg": "grade slope slope_angle inclination incline",
    "time": "timestamp",
    "run": "test trial experiment run_id test_id",
    "wheel_radius": "radius r",
    "wheel_width": "width b",
    "grouser_height": "grouser lug_height grousers lugs",
}
#: Names that could be more than one column, or are none.
UNCLEAR = {
    "force": "'drawbar_pull' (along the ground) or 'load' (on the wheel)",
    "f": "'drawbar_pull' (along the ground) or 'load' (on the wheel)",
    "t": "'torque' or 'time'",
    "m": "'torque' (a moment) or 'load' (N: a mass in kilograms times 9.81)",
    "mass": "'load' (N: a mass in kilograms times 9.81)",
    "w": "'load' (N), or the rotational speed, which is no column: slip holds it",
    "mx": "'torque' (about the axle; with x ahead that is My)",
    "mz": "'torque' (about the axle; with x ahead that is My)",
    "moment_x": "'torque' (about the axle; with x ahead that is My)",
    "thrust": "'drawbar_pull' (N, measured at the axle: thrust less resistance)",
    "gross_traction": "'drawbar_pull' (N, measured at the axle: thrust less resistance)",
    "diameter": "'wheel_radius' (m, half the diameter)",
    "wheel_diameter": "'wheel_radius' (m, half the diameter)",
}
UNCLEAR |= dict.fromkeys(
    (
        *("omega", "rpm", "angular_velocity", "angular_speed", "wheel_speed", "rotational_speed"),
        *("rim_speed", "wheel_velocity", "wheel_omega"),
    ),
    "'speed' (travel)? A rotational speed is no column: 'slip' is 1 - V/(r w) where it drives",
)
#: Units behind a name, and how a value in them is converted, by the unit of the column.
FACTORS = {
    "mm": "divide by 1000",
    "cm": "divide by 100",
    "kn": "multiply by 1000",
    "kg": "multiply by 9.81",
    "kgf": "multiply by 9.81",
    "nmm": "divide by 1000",
    "ncm": "divide by 100",
    "knm": "multiply by 1000",
    "pct": "divide by 100",
    "percent": "divide by 100",
    "%": "divide by 100",
    "rad": "multiply by 57.3",
    "mm/s": "divide by 1000",
    "cm/s": "divide by 100",
    "km/h": "divide by 3.6",
    "kmh": "divide by 3.6",
    "ms": "divide by 1000",
}
#: Units that columns have.
SAME = ("m", "n", "nm", "deg", "s", "m/s", "mps", "-", "1")
#: A name with a unit behind it, parted by a space or an underscore, or in brackets.
_UNIT = re.compile(
    r"(?P<name>.*?)_*(?:(?<=_)|[\[(])(?P<unit>"
    + "|".join(map(re.escape, (*FACTORS, *SAME)))
    + r")[\])]?"
)
_QUOTED = re.compile(r"'(\w+)'")
_NEWTON_METRES = re.compile(r"(?<![a-z])n[\s·*]m(?![a-z])")


def meant(name: str, header: Collection[str], known: Collection[str]) -> str:
    """'; did you mean ...?' of an unknown column, with its unit; "" where none is like it, or
    where the `header` has that column too.
    """
    joined = _NEWTON_METRES.sub("nm", name.strip().lower())
    plain = re.sub(r"[\s.]+|-(?=\w)", "_", joined)
    found = _UNIT.fullmatch(plain)
    bare = found["name"].strip("_") if found else plain
    unit = found["unit"] if found else ""
    for text in (plain, bare):
        if said := UNCLEAR.get(text):
            all_there = {*_QUOTED.findall(said)} <= {*header}
            return "" if all_there else f"; did you mean {said}{'' if '?' in said else '?'}"
        column = _column(text, known)
        if column and column in header:
            return ""
        if column:
            factor = f": {FACTORS[unit]}" if unit in FACTORS and column in MEANT else ""
            return f"; did you mean {column!r}{_unit(column, factor)}?"
    return nearest(bare, known)


def _column(name: str, known: Collection[str]) -> str:
    """The column of a name; "" where it is no known one."""
    if name in known:
        return name
    return next((column for column, names in OTHER_NAMES.items() if name in names.split()), "")


def _unit(column: str, factor: str) -> str:
    return f" ({MEANT[column]}{factor})" if column in MEANT else ""
