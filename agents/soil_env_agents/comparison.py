"""Comparison at the end of a training: the agent and the classical controllers on the same held-out
courses.
"""

from contextlib import suppress
from pathlib import Path

from soil_env._io.loading import ParameterError, to_dict
from soil_env.parameters import RoverScenario, Scenario

from . import cells
from .agent import Agent
from .common_layout import CommonScaling
from .config import TrainConfig
from .controllers.rover import controllers_of
from .default_policy import NAME
from .evaluate.command import carry_out
from .evaluate.contestants import SHIPPED_CLASS, Contestant, digest
from .evaluate.evaluation import Evaluation, as_begun
from .evaluate.tables import points
from .progress import show

FOLDER = "comparison"  # in a run folder, with the files of `soil-env evaluate`
DONE = f"{FOLDER}/evaluation.json"
_BLOCK = 500  # courses side by side, at most
_WITH_TRUE_SOIL = "best_slip_true"


def compare(
    run: Path, config: TrainConfig, scenario: Scenario | RoverScenario, agent: Agent
) -> None:
    """Evaluate the classical controllers, the default policy where it can drive the scenario, and
    the agent on the held-out courses; print a `verdict`.

    Results are in the folder `FOLDER` of `run`, as of `soil-env evaluate`. An interrupted
    comparison goes on. Where the model was trained again, or the config is another, only what
    depends on it is driven anew.
    """
    folder = run / FOLDER
    model = str((run / "model.zip").resolve())  # the same from every folder
    controllers = [Contestant(name, 0, "classical", name) for name in controllers_of(scenario)[0]]
    with suppress(ParameterError):  # of a scenario that the policy of the package cannot drive
        CommonScaling(scenario)
        controllers.append(Contestant(NAME, 0, "class", SHIPPED_CLASS))
    controllers.append(Contestant(agent.name, 0, "model", model, digest(model)))
    asked = Evaluation(
        to_dict(scenario),
        {c.key: c for c in controllers},
        config.courses,
        block=min(_BLOCK, config.courses),
        tuning_courses=config.tuning_courses,
        oracle_courses=config.oracle_courses or 0,
        model=config.model,
        detailed=False,
    )
    with suppress(cells.OtherStudy):
        asked = as_begun(asked, folder)
    result = carry_out(asked, folder)
    show(verdict(result, agent.name))


def verdict(result: dict, name: str) -> str:
    """Sentence with the difference in courses finished between the agent `name` and the best
    controller that does not know the true soil; `result`: content of evaluation.json.
    """
    rows = result["controllers"]
    best = max(
        (n for n in rows if n not in (name, _WITH_TRUE_SOIL)),
        key=lambda n: rows[n]["finished"]["value"],
    )
    difference = points(result["paired"][name][best]["finished"])
    return (
        f"{name} against {best}, the best of the others without the true soil: {difference} "
        "percentage points of courses finished, on the same courses. One training seed; the "
        "interval is over courses."
    )
