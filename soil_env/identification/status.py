"""Status of an online estimate."""

import enum


class Status(enum.IntEnum):
    """Status of an online estimate; 3 to 5 are unused: recorded numbers keep their meaning."""

    NO_DATA = 0  # no point yet: the estimate is the prior
    CONVERGED = 1
    NOT_EXCITED = 2  # phi or ln K is hardly narrower than the prior
    MISFIT = 6  # readings of this soil contradict the laws by more than their errors explain
