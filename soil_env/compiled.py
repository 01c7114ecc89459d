"""How the functions of a step are compiled.

`_nrt=False` takes numba's reference counting and heap out of them: two threads that count references to the same
arrays slow each other down, and a function that would allocate does not compile. Scratch is `lanes.scratch`, on the
stack. `error_model="numpy"`: a division by zero gives inf, as in numpy, not a test and an exception.
"""

from numba import njit

#: For functions of a step.
kernel = njit(cache=True, error_model="numpy", _nrt=False)
#: The same for small ones whose values should stay in registers: always inlined.
inlined = njit(cache=True, error_model="numpy", _nrt=False, forceinline=True)
