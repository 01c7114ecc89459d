"""The agent that comes with the package: one student for every ground of a wheel. Needs numpy only.

`python -m soil_env_agents.generalist` trains it. The file of weights holds arrays without pickles,
and how it was made.
"""

import json
from pathlib import Path

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env.parameters import RoverScenario, Scenario, load_scenario
from soil_env.simulation.task import ROUTES, check_version, layout

from . import common_layout, inputs
from .archives import check_unpacked
from .history import History, Remembering

WEIGHTS = Path(__file__).with_name("default_policy.npz")
NAME = "default_policy"
MOST_BYTES = 2**26  # unpacked; the shipped file has a fourth of a megabyte
CLIP = 10.0  # of a normalised input
LAYERS = ("policy_0", "policy_1", "action")  # each with a weight [out, in] and a bias [out]
# End of the messages about a file that holds no weights of a default policy.
_EXPECTED = (
    f"expected an .npz of {__package__}.generalist; the shipped one comes again with an "
    "installation"
)


class DefaultPolicy(Remembering):
    """A trained student with `predict` on observations `identified` of the `scenario`, in their
    units; `path`: its weights.

    ParameterError for a scenario that does not fit the common layout, and for a file that is not
    the weights of such a policy in this version's layout.
    """

    name = NAME
    variant = "identified"
    clip = CLIP

    def __init__(self, scenario: Scenario | str, path: str | Path = WEIGHTS):
        if not isinstance(scenario, (Scenario, RoverScenario)):
            scenario = load_scenario(scenario)
        self.scaling = common_layout.CommonScaling(scenario)
        try:
            check_unpacked(path, MOST_BYTES)
            with np.load(path, allow_pickle=False) as archive:
                arrays = {name: archive[name] for name in archive.files}
            self.made = json.loads(str(arrays.pop("made")))
            names = tuple(self.made["observation_names"])
            self.history = History(names, int(self.made["history"]))
            self.mean = arrays["mean"]
            self.sd = arrays["sd"]
            self.layers = [(arrays[f"{name}_weight"], arrays[f"{name}_bias"]) for name in LAYERS]
            finite = all(np.isfinite(values).all() for values in arrays.values())
            size = (len(names) + self.history.size,)
            if not (finite and (self.sd > 0.0).all() and self.mean.shape == self.sd.shape == size):
                raise ValueError
        except OSError as error:
            raise ParameterError(
                f"{path}: cannot be read ({error.strerror or error}); expected an .npz"
            ) from None
        except Exception as error:  # a broken zip fails in a dozen ways
            raise ParameterError(
                f"{path}: not the weights of a default policy ({type(error).__name__}): {_EXPECTED}"
            ) from None
        check_version(self.made.get("observation_version", 1), path)
        if names != common_layout.NAMES:
            raise ParameterError(
                f"{path}: trained on another observation layout; expected that of "
                f"{common_layout.__name__}"
            )
        self.choice = names.index("choice")
        self.margins = [[names.index(f"{route}_margin")] for route in ROUTES]
        try:  # layers that do not fit each other raise ValueError or give another shape
            with np.errstate(over="ignore", invalid="ignore"):
                tried = self.action(np.zeros((1, self.mean.size), dtype=np.float32))
            if tried.shape != (1, 1):
                raise ValueError
        except ValueError:
            raise ParameterError(
                f"{path}: layers whose shapes do not fit each other: {_EXPECTED}"
            ) from None
        self.scenario = scenario
        self.layout = inputs.Layout(layout(self.variant, scenario.course), self.variant)

    def act(self, x, deterministic):
        """Actions [n, 1] in [-1, 1] for inputs [n, D]; they are the same whatever `deterministic`
        says.
        """
        return np.clip(self.action(x), -1.0, 1.0)

    def action(self, x):
        """Actions [n, 1], not yet cut to [-1, 1], for normalised observations [n, D] with their
        history; arrays, or values of an ONNX graph.

        Where a route is chosen an action is the margin of the route ahead less that of the other,
        whose moments are the same.
        """
        drive = _network(self.layers, x)
        ahead, beside = (x[:, column] for column in self.margins)
        # The entry is normalised: where it is 1 it is above its mean, else below.
        return np.where(np.greater(x[:, [self.choice]], 0.0), ahead - beside, drive)


def _network(layers, x):
    """Output [n, out] of a network for inputs x [n, in]: hidden layers with rectified units and a
    linear last one.

    `layers`: (weight [out, in], bias [out]) of each.
    """
    *hidden, (last, bias) = layers
    for weight, b in hidden:
        # float32, as a graph takes no two types
        x = np.maximum(x @ weight.T + b, np.float32(0.0))
    return x @ last.T + bias
