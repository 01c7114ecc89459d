"""Logs of rovers: recordings to time-aligned wheel readings, steady points, and the soil over time.

`mapping` says which topic, field or column is which reading, `recordings` opens the file, `bags` and `tables` read it,
`align` puts all readings on one time axis, `steady` finds the steady stretches, `replay` runs the online identifier,
`report` writes what was found. `python -m soil_env.logs --help` describes the files.
"""

from soil_env.logs.align import Aligned
from soil_env.logs.mapping import LogMap, Source, Windows, read_map
from soil_env.logs.recordings import read_recording
from soil_env.logs.replay import Replay, replay
from soil_env.logs.steady import Steady, steady_windows

__all__ = [
    "Aligned",
    "LogMap",
    "Replay",
    "Source",
    "Steady",
    "Windows",
    "read_map",
    "read_recording",
    "replay",
    "steady_windows",
]
