"""Results of a study: study.json, one table and one figure."""

from pathlib import Path

from soil_env._io.document import Table
from soil_env._io.files import replace_file, write_json
from soil_env._io.loading import to_dict
from soil_env.terramechanics.model import WheelSoilModel

from ..evaluate import comparing
from ..evaluate.tables import cell, draw_metrics, points
from . import work
from .config import Study

FILES = ("study.json", "study.md", "study.png")


def result(study: Study, folder: Path) -> dict:
    """The content of study.json, of the cells that are done.

    {"version", "courses", "arms": {name: its config}, "baseline", "settings": {cell: settings of
    its controller, given or tuned}, "worlds": {name: what acts}, "scenarios": {name: a `comparison`
    of the arms, "trained_on", and "model" of its world}}. Scenarios on which no arm is done are
    left out.
    """
    runs, settings = work.driven(study, folder)
    return {
        "version": study.version,
        "arms": {name: to_dict(arm) for name, arm in study.arms.items()},
        "baseline": study.compared_with,
        "courses": study.courses,
        "settings": settings,
        "worlds": {name: _acting(w.world) if w.world else {} for name, w in study.worlds.items()},
        "scenarios": {
            name: {
                **comparing.comparison(
                    study.targets[name].scenario, study.held_out, own, resamples=study.resamples
                ),
                "trained_on": study.targets[name].trained_on or name,
                "model": study.targets[name].model,
            }
            for name, own in runs.items()
        },
    }


def _acting(world: WheelSoilModel) -> dict:
    """What acts in a world: {name of an effect: its parameters}, and words for the number of terms
    of its residual and for a table of its remainder, if there are some.
    """
    residual = {"residual": f"{len(world.residual)} terms"} if world.residual else {}
    remainder = {"remainder": "a table"} if world.remainder is not None else {}
    return {**world.effects, **residual, **remainder}


def table(content: dict, bounds: bool = True) -> Table:
    """A row for each scenario and arm; differences are on the same courses.

    Without `bounds` it is narrow: no intervals but that of the difference, and no probabilities.
    """
    base = content["baseline"]
    rows = []
    for name, entry in content["scenarios"].items():
        for arm, metrics in entry["controllers"].items():
            difference = ""
            probability = ""
            if arm != base and base in entry["controllers"]:
                difference = points(entry["paired"][arm][base]["finished"])
                probability = cell(entry["improvement"][arm][base])
            rates = (cell(metrics[m], 100.0, 1, bounds=bounds) for m in ("immobilised", "finished"))
            iqm = cell(entry["iqm"][arm], bounds=bounds)
            rows.append([name, arm, entry["members"][arm], *rates, iqm, difference, probability])
    caption = f"{content['courses']} held-out courses of each scenario; 95 % intervals"
    if bounds:
        wide = (
            "scenario",
            "arm",
            "seeds",
            "immobilised [%]",
            "finished [%]",
            "return (IQM)",
            f"finished - {base} [points]",
            "P(return higher)",
        )
        return Table(wide, rows, caption)
    narrow = ("scenario", "arm", "seeds", "stuck [%]", "finished [%]", "IQM", "difference")
    return Table(
        narrow,
        [row[:-1] for row in rows],
        f"{caption}; IQM of the return; difference: finished - {base}",
    )


def write(content: dict, folder: Path) -> None:
    """Write the `FILES`."""
    write_json(folder / FILES[0], content)
    found = [
        f"World `{name}`: {acting or 'no effects'}." for name, acting in content["worlds"].items()
    ]
    page = ["# Study", *found, table(content).markdown(), "![Study](study.png)"]
    replace_file(folder / FILES[1], "\n\n".join(page) + "\n")
    rows = {name: entry["controllers"] for name, entry in content["scenarios"].items()}
    replace_file(folder / FILES[2], draw_metrics(rows, comparing.MAIN))
