"""What importing and stepping environments leaves behind in numba and in the process: nothing."""

import pytest

from tests.programs import python

CODE = """
import gc, json, operator, signal, sys
import numba
import numpy as np
from numba.core.datamodel.registry import default_manager
from numba.core.registry import cpu_target
from numba.core.target_extension import CPU, dispatcher_registry
from numba.core.typing.templates import builtin_registry
from numba.core.typing.typeof import typeof_impl

OPERATORS = [f for name, f in vars(operator).items() if not name.startswith("_") and callable(f)]


@numba.njit
def plain(x):  # numba loads much of itself at its first compilation
    return x + 1.0, np.exp(x), x > 0.0 and not x == 2.0


def left():
    context = cpu_target.typing_context
    context.refresh()
    known = context._functions
    templates = [[repr(t) for t in builtin_registry.functions if t.key is f] for f in OPERATORS]
    of_operators = [known[f] for f in OPERATORS if f in known]
    typed = [len(x if isinstance(x, list) else x.templates) for x in of_operators]
    ours = [*typeof_impl.registry, *default_manager._handlers, *builtin_registry.functions]
    return {
        "templates of operators": templates,
        "typing of operators": typed,
        "registered by us": [repr(x) for x in ours if x.__module__.startswith("soil_env")],
        "options": dir(cpu_target.options),
        "dispatcher": repr(dispatcher_registry[CPU]),
        "cache": numba.config.CACHE_DIR,
        "signals": {int(s): repr(signal.getsignal(s)) for s in signal.valid_signals()},
        "garbage": [gc.isenabled(), len(gc.callbacks), gc.get_threshold()],
        "tracing": [repr(sys.gettrace()), repr(sys.getprofile()), repr(sys.excepthook)],
        "identifier": [n for n in sys.modules if n.startswith("soil_env.identification.online")],
    }


plain(0.5)
before = left()
import gymnasium
blind = {"observation": "blind", "belief": {"method": "none"}}  # without the identifier
for env in (gymnasium.make(sys.argv[1], **blind), gymnasium.make_vec(sys.argv[1], 2, **blind)):
    env.reset(seed=0)
    env.step(env.action_space.sample())
after = left()
print(json.dumps([name for name in before if before[name] != after[name]]))
"""


@pytest.mark.parametrize("name", ["soil_env:SoilWheel-v0", "soil_env:SoilRover-v0"])
def test_an_environment_leaves_numba_and_the_process_as_they_were(name):
    assert python("-c", CODE, name).stdout == "[]\n"
