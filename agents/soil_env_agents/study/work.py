"""Work of a study: train or tune arms, and drive them over the held-out courses.

study.yaml            the study, resolved; another study may not go on in this folder
trained/CELL/         run folder of a training: config.yaml, model.zip, checkpoint.zip on the way
tuned/CELL.log        trials of a tuning
cells/CELL.json       all courses as driven by one arm with one training seed: the cell is done
"""

import tempfile
from pathlib import Path

from soil_env._io.files import is_unused, replace_files
from soil_env._io.loading import ParameterError, read_yaml, to_dict
from soil_env.parameters import Scenario

from .. import cells
from ..evaluate.contestants import Contestant
from ..evaluate.driving import Runs, run_courses
from ..evaluate.loading import load
from ..evaluate.own import code_digest
from ..evaluate.tuning import shipped_settings, tuned_settings
from ..progress import show
from .config import Cell, Study


def begin(study: Study, folder: Path) -> None:
    """Write study.yaml; ParameterError where the folder holds another study, other files, or agents
    that other code has trained.

    Seeds, baseline and resamples of the study that it holds may be others: cells that are there
    stay good.
    """
    if cells.is_begun(study, folder, ignored=("seeds", "baseline", "resamples")):
        path = folder / cells.STUDY
        begun = read_yaml(path)["version"]
        if begun != study.version and not is_unused(folder / "trained"):
            raise ParameterError(
                f"{path}: its agents were trained with soil_env {begun}, this is {study.version}; "
                "give another --out"
            )
    cells.save_study(study, folder)


def fill(study: Study, folder: Path, engine: cells.Engine, elsewhere: bool) -> None:
    """Do all cells that are not done; `elsewhere`: on machines that do not share `folder`."""
    todo = study.cells()
    left = len(todo)

    def progress(cell: Cell) -> None:
        """Print that a cell is done."""
        nonlocal left
        left -= 1
        show(f"{cell}: done, {left} of {len(todo)} cells left")

    def kept(work, missing):
        """The engine, which also writes the files of a training made elsewhere to trained/CELL."""
        for cell, content in engine(work, missing):
            if files := content.pop("files", {}):
                replace_files(folder / "trained" / str(cell), files)
            yield cell, content

    job = Work(study, None if elsewhere else folder)
    cells.fill(job, todo, folder, kept, progress, job.needs)


class Work:
    """Does cells; can be sent to other processes and, without a folder, to other machines."""

    def __init__(self, study: Study, folder: Path | None):
        self.study = study
        self.folder = folder
        # With worlds nothing is taken from the package, which has settings for a world without
        # effects alone: so all are tuned by as many trials on as many courses.
        self._anew = bool(study.worlds)

    def needs(self, cell: Cell) -> dict:
        """All that the result of a cell depends on beside its name, as plain values: where they
        have changed since it was stored, the cell is done again.

        `targets`: the one that it learns on, then those that it is driven on.
        """
        study = self.study
        arm = study.arms[cell.arm]
        targets = [study.targets[name] for name in (cell.source, *study.fed_by(cell.source))]
        shipped = {}
        if not (arm.settings or self._anew):
            shipped = shipped_settings(targets[0].scenario, study.tuning_courses)
        return {
            "arm": to_dict(arm),
            "shipped": shipped.get(arm.controller, {}),  # what its tuning may take as it is
            # of a user's controller, given as "module:Class"
            "code": code_digest(arm.controller) if ":" in arm.controller else "",
            "world": to_dict(study.worlds[arm.world]) if arm.world else {},
            "targets": [to_dict(target) for target in targets],
            "courses": [study.held_out, study.courses, study.tuning_courses],
            "version": study.version,
        }

    def __call__(self, cell: Cell) -> dict:
        """{"settings": of a controller, {} of an agent, "driven": {target: columns of `Runs`}}.

        Without a folder also "files": {name: content} of the files in the run folder of a training,
        {} of a controller.
        """
        if self.folder is not None:
            return self._done(cell, self.folder)
        with tempfile.TemporaryDirectory() as there:
            out = self._done(cell, Path(there))
            run = Path(there) / "trained" / str(cell)
            return {
                **out,
                "files": {f.name: f.read_bytes() for f in sorted(run.glob("*")) if f.is_file()},
            }

    def _done(self, cell: Cell, folder: Path) -> dict:
        """Train or tune the arm of a cell in `folder` and drive it; {"settings", "driven"}."""
        study = self.study
        arm = study.arms[cell.arm]
        source = study.targets[cell.source]
        model = (study.worlds[arm.world] if arm.world else source).world
        settings: dict = {}
        made = arm.controller  # `Contestant.source`
        if not arm.controller:
            from .. import training  # needs the extra `train`, which --help does not

            kind = "model"
            made = str(
                training.trained(study.training(cell, model, folder / "trained"), source.scenario)
            )
        else:
            kind = "class" if ":" in arm.controller else "classical"
            settings = arm.settings or self._tuned(cell, source.scenario, model, folder)
        driven = {}
        contestant = Contestant(cell.arm, 0, kind, made, settings=settings)
        for name in study.fed_by(cell.source):
            target = study.targets[name]
            try:
                controller = load(contestant, target.scenario)
                runs = run_courses(
                    controller,
                    target.scenario,
                    study.held_out,
                    study.courses,
                    model=target.world,
                    threads=1,
                )
            except ParameterError as error:
                raise ParameterError(f"arms.{cell.arm}, on {name}: {error}") from None
            driven[name] = runs.columns()
        return {"settings": settings, "driven": driven}

    def _tuned(self, cell: Cell, scenario: Scenario, model, folder: Path) -> dict[str, float]:
        """Settings of the controller of a cell, tuned on the scenario in the world of `model`.

        {} for a controller that has none.
        """
        name = self.study.arms[cell.arm].controller
        log = folder / "tuned" / f"{cell}.log"
        log.parent.mkdir(parents=True, exist_ok=True)
        courses = self.study.tuning_courses
        return tuned_settings(scenario, courses, (name,), model, log, self._anew).get(name, {})


def driven(study: Study, folder: Path) -> tuple[dict[str, dict[str, list[Runs]]], dict[str, dict]]:
    """Results of the cells that are done: ({target: {arm: [runs of each training seed]}},
    {cell: settings of its controller}).

    Targets without runs and cells without settings are left out.
    """

    def parse(content: dict) -> dict:
        """Content of a cell with `Runs` in place of their columns."""
        own = {
            t: Runs.from_columns(columns, study.courses) for t, columns in content["driven"].items()
        }
        return {**content, "driven": own}

    runs: dict[str, dict[str, list[Runs]]] = {name: {} for name in study.targets}
    settings = {}
    job = Work(study, folder)
    for cell in study.cells():
        if not cells.is_done(folder, cell, job.needs):
            continue
        content = cells.read_cell(folder, cell, parse)
        if content["settings"]:
            settings[str(cell)] = content["settings"]
        for target, own in content["driven"].items():
            runs[target].setdefault(cell.arm, []).append(own)
    return {
        t: {arm: own[arm] for arm in study.arms if arm in own} for t, own in runs.items() if own
    }, settings
