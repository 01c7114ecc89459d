"""Time stamps of a recording in order: which of them can be right.

A recorder writes readings as they come, so stamps rise, but for readings that are a little late. A
stamp of the future, a zero, or a clock that is set back breaks that. The largest set of stamps that
never goes back is taken for right, and what lies beside it is left out.
"""

from array import array
from bisect import bisect_right

import numpy as np

from soil_env._io.loading import ParameterError

from .notes import Notes

LATEST = 2**62  # [ns] from 1970, the year 2116
_FAR = 10**15  # [ns] 12 days: stamps further from all others belong to another clock
_ALONE = 100.0  # [median intervals] around a single reading that counts as alone
#: Equal stamps, and no others, of a clock that stands; also successive stamps left out from which a
#: clock counts as set back. Own choice.
_STANDS = 10


class Stamps:
    """Stamps of the rows of a table, or the messages of a topic, in the order of the recording."""

    def __init__(self, source: str, thing: str) -> None:
        self.source = source  # column or topic in words, for notes
        self.thing = thing  # row or message
        self.times = array("q")  # [ns]
        self.recorded = array("q")  # [ns] of the recording of a message
        self.numbers = array("q")  # of rows or messages, by which notes name them
        self._files = [0]  # stamps before each file

    def __len__(self) -> int:
        """Number of stamps so far."""
        return len(self.times)

    def add(self, time: int, number: int, recorded: int = 0) -> None:
        """Add the stamp of a row or message of this `number`, and when a message was `recorded`,
        both times in ns.
        """
        self.times.append(time)
        self.numbers.append(number)
        self.recorded.append(recorded)

    def begin(self) -> None:
        """Begin another file, whose times may lie before those of the last."""
        self._files.append(len(self))

    def settle(self, times: np.ndarray, slack: int, restart: int, notes: Notes) -> np.ndarray:
        """True [N] for each of the stamps `times` [ns] that counts: `sound`, file by file.

        Notes say which are left out, which are late by at most `slack` [ns], and which repeat the
        stamp before. `restart` [ns]: gap after which a single stamp counts as alone.
        `ParameterError` where less than half is left, or the clock stands.
        """
        kept = np.zeros(times.size, bool)
        for first, end in zip(self._files, [*self._files[1:], times.size], strict=True):
            kept[first:end] = sound(times[first:end], slack, restart)
        self._check(times, kept, notes)
        out = np.flatnonzero(~kept)
        if out.size:
            notes.add(
                f"{self.source}: left out {out.size} of {times.size} time stamps, out of order "
                f"with those around. The first is {self._place(times, out[0])}."
                + self._set_back(times, out, restart)
            )
        rising = times[kept]
        latest = np.maximum.accumulate(rising)
        late = np.flatnonzero((rising < latest) & (latest - rising <= slack))
        if late.size:
            k = np.flatnonzero(kept)[late[0]]
            notes.add(
                f"{self.source}: put {late.size} of {times.size} {self.thing}s, late by at most "
                f"{slack * 1e-9:g} s (max_gap), where their time says. The first is {self.thing} "
                f"{self.numbers[k]} ({times[k] * 1e-9:.3f} s after {latest[late[0]] * 1e-9:.3f} s)."
            )
        same = np.flatnonzero(np.diff(rising) == 0)
        if same.size:
            k = np.flatnonzero(kept)[same[0] + 1]
            coarse = " Take a finer time, or a longer period and max_gap in the map."
            notes.add(
                f"{self.source}: the stamp before once more in {same.size} of {times.size} time "
                f"stamps. Their readings are averaged. The first is that of {self.thing} "
                f"{self.numbers[k]}." + (coarse if 2 * same.size > rising.size else "")
            )
        return kept

    def _check(self, times: np.ndarray, kept: np.ndarray, notes: Notes) -> None:
        """Raise `ParameterError` where all stamps are equal, at least `_STANDS` of them, and where
        less than half is `kept` [N].
        """
        said = ""
        if times.size >= _STANDS and np.all(times == times[0]):
            said = (
                f"all {times.size} time stamps are {times[0] * 1e-9:.3f} s: expected time that "
                "passes"
            )
        elif 2 * np.sum(kept) < times.size:
            said = (
                f"{np.sum(~kept)} of {times.size} time stamps do not fit those around them, first "
                f"{self._place(times, int(np.argmin(kept)))}: expected time that rises"
            )
        if said:
            header = "; try clock: log" if self.thing == "message" else ""
            raise ParameterError(f"{notes.path}: {self.source}: {said}{header}")

    def _set_back(self, times: np.ndarray, out: np.ndarray, restart: int) -> str:
        """Sentence on where the clock goes back most; empty where it is not set back.

        It is set back if `_STANDS` successive stamps are left out (`out`: indices) and a stamp is
        `restart` [ns] or more before the stamp that precedes it.
        """
        fall = np.diff(times)
        k = int(np.argmin(fall)) + 1
        most = max(part.size for part in np.split(out, np.flatnonzero(np.diff(out) > 1) + 1))
        if most < _STANDS or fall[k - 1] > -restart:
            return ""
        return (
            f" The clock goes back at {self._place(times, k)}: where two recordings are in one "
            "file, split it there."
        )

    def _place(self, times: np.ndarray, k: int) -> str:
        """Number and stamp of the row or message `k`, and the stamp before it."""
        before = f" after {times[k - 1] * 1e-9:.3f} s" if k else ""
        return f"{self.thing} {self.numbers[k]} ({times[k] * 1e-9:.3f} s{before})"


def sound(times: np.ndarray, slack: int, restart: int) -> np.ndarray:
    """True [N] for the stamps `times` [N] in ns that can be right.

    Right is the largest set that never goes back, less stamps that are alone or of another clock
    (`_together`). Right are also stamps at most `slack` [ns] outside their two neighbours in that
    set, and stamps at most `restart` [ns] before its first or after its last.
    """
    if times.size == 0:
        return np.zeros(0, bool)
    rising = _longest_rising(times)
    rising = rising[_together(times[rising], restart)]
    known = times[rising]
    # Of each stamp: how many of the set come no later in the recording.
    place = np.searchsorted(rising, np.arange(times.size), side="right")
    # Of a stamp before the first of the set, or after the last, only one side is known.
    before = known.take(place - 1, mode="clip")
    after = known.take(place, mode="clip")
    out = times >= before - np.where(place > 0, slack, restart)
    out &= times <= after + np.where(place < known.size, slack, restart)
    out[rising] = True
    return out


def _longest_rising(times: np.ndarray) -> np.ndarray:
    """Indices [n] of the longest subsequence of `times` [N] that never falls (Schensted 1961)."""
    if np.all(times[1:] >= times[:-1]):
        return np.arange(times.size)
    ends: list[int] = []  # least last time of the subsequences of length 1, 2, ...
    places: list[int] = []  # indices of these times
    before = []  # index of the element before, -1 of a first one
    for k, time in enumerate(times.tolist()):
        length = bisect_right(ends, time)
        before.append(places[length - 1] if length else -1)
        ends[length : length + 1] = [time]
        places[length : length + 1] = [k]
    chain = [places[-1]]
    while before[chain[-1]] >= 0:
        chain.append(before[chain[-1]])
    return np.array(chain[::-1])


def _together(times: np.ndarray, restart: int) -> np.ndarray:
    """True [N] for rising stamps `times` [N] in ns, False for those alone or of another clock.

    Stamps are parted where a gap is longer than `restart` [ns] and `_ALONE` median intervals. The
    largest part stays. Another is left out if it has one stamp, or is further than `_FAR` away.
    """
    out = np.ones(times.size, bool)
    gaps = np.diff(times)
    if gaps.size == 0:
        return out
    apart = max(restart, _ALONE * np.median(gaps))
    parts = np.split(np.arange(times.size), np.flatnonzero(gaps > apart) + 1)
    most = max(parts, key=len)
    for part in parts:
        away = max(times[most[0]] - times[part[-1]], times[part[0]] - times[most[-1]])
        if part is not most and (part.size == 1 or away > _FAR):
            out[part] = False
    return out
