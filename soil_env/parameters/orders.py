"""Orders to the compiled functions: what is to be done with a vehicle or its course."""

import numpy as np

STEP = np.int8(0)  # the control periods of an action
RESTART = np.int8(1)  # a new course, at rest at its start
IDLE = np.int8(2)  # nothing
TRY = np.int8(3)  # draw a whole course as a trial
COMPLETE = np.int8(4)  # draw the rest of the course
AHEAD = np.int8(5)  # draw the ground ahead of the vehicle
