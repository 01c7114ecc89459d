"""Logs of rovers: recordings to time-aligned wheel readings, steady points, and the soil over time.

`mapping` names topic, field or column of each reading. `recordings` opens the file, which `bags` or
`tables` read. `align` puts all readings on one time axis. `replay` runs the online identifier,
`steady` finds the steady windows by ground, and `report` makes the files. `soil-env logs --help`
describes these.
"""

from .align import Aligned
from .mapping import LogMap, Source, Windows, read_map
from .recordings import read_recording
from .replay import Replay, replay
from .steady import Steady, steady_windows

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
