"""`soil-env study`: arms over seeds and scenarios, numbers of the saved models, going on after a
kill, bad input.
"""

import dataclasses
import json
import pickle
import shutil

import pytest
import yaml

from soil_env._io.loading import config_dir
from soil_env.cli import main as soil_env
from soil_env.parameters import soils
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel
from soil_env.terramechanics.residual import ResidualTerm
from soil_env_agents import cells
from soil_env_agents.agent import load_agent
from soil_env_agents.controllers import CONTROLLERS, make_controller
from soil_env_agents.controllers.rover import ROVER_CONTROLLERS
from soil_env_agents.evaluate.contestants import SHIPPED_CLASS
from soil_env_agents.evaluate.driving import run_courses
from soil_env_agents.evaluate.models import load_model
from soil_env_agents.study import work
from soil_env_agents.study.config import Study, read_config
from soil_env_agents.training import BEGUN, open_run
from tests.refusals import refused_command

WORLD = config_dir() / "worlds" / "bulldozing.yaml"
PPO = {"num_envs": 4, "n_steps": 16, "batch_size": 32, "n_epochs": 1, "layer": 4, "threads": 1}
CONFIG = {
    "changes": {"course": {"length": 2.0}, "control": {"time_limit": 6.0}},
    "scenarios": {
        "mixed": {},
        "elsewhere": {"scenario": "unseen", "trained_on": "mixed", "model": "effect.yaml"},
    },
    "controllers": ["full_throttle", "soft_start"],
    "train": {"timesteps": 192, "checkpoint_every": 64, "ppo": PPO},
    "arms": {
        "identified": {"train": {"hidden_worlds": 1, "ppo": {"history": 2}}},
        "true_soil": {"train": {"observation": "true_soil"}},
        "given": {"controller": "soft_start", "settings": {"speed": 0.2}},
        "mine": {"controller": "tests.agents.drivers:Half"},
    },
    "seeds": 2,
    "courses": 6,
    "tuning_courses": 1,
    "resamples": 50,
}


def config(folder, **changes):
    """Path of the config of a small study in `folder`, `CONFIG` with top-level keys replaced; the
    world that it names is put beside it.
    """
    shutil.copy(WORLD, folder / "effect.yaml")
    path = folder / "study.yaml"
    path.write_text(yaml.safe_dump(CONFIG | changes, sort_keys=False))
    return path


def main(arguments):
    """Exit status of `soil-env study`, which may import what the file names."""
    return soil_env(["study", "--allow-code", *map(str, arguments)])


def refused(capsys, *arguments):
    """stderr of a command that has to be refused: one line, status 2."""
    return refused_command(capsys, "soil-env study", main, *arguments).err


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A finished study."""
    folder = tmp_path_factory.mktemp("study")
    assert main(["--config", str(config(folder)), "--out", str(folder / "out")]) == 0
    return folder / "out"


def read(folder):
    """Results of a study."""
    return json.loads((folder / "study.json").read_text())


@pytest.fixture()
def copied(finished, tmp_path):
    """A copy of the finished study."""
    return shutil.copytree(finished, tmp_path / "out")


def test_a_module_that_only_a_file_names_is_not_imported(capsys, tmp_path, copied):
    """The command line may name it."""
    path = config(tmp_path, arms={"mine": {"controller": "a_module_of_others:Thing"}})
    new = ["--config", path, "--out", tmp_path / "new"]
    named = ["--arms.mine.controller", "a_module_of_others:Thing"]
    run = "which would be imported and run: expected --allow-code"
    for given, said in (
        (new, run),
        (["--out", copied], run),
        ([*new, *named], "cannot be imported"),
    ):
        err = refused_command(capsys, "soil-env study", soil_env, "study", *given).err
        assert said in err and not (tmp_path / "new").exists()


def test_the_shipped_policy_may_stand_among_the_controllers(tmp_path):
    study = read_config(config(tmp_path, controllers=["soft_start", "default_policy"]))
    assert study.arms["default_policy"].controller == SHIPPED_CLASS


def test_every_arm_is_compared_on_every_scenario(finished):
    result = read(finished)
    assert list(result["scenarios"]) == ["mixed", "elsewhere"] and result["baseline"] == "mine"
    members = dict.fromkeys(("full_throttle", "soft_start", *CONFIG["arms"]), 1)
    members |= {"identified": 2, "true_soil": 2}
    for name, entry in result["scenarios"].items():
        assert list(entry["controllers"]) == list(members) and entry["members"] == members
        assert entry["trained_on"] == "mixed" and bool(entry["model"]) == (name == "elsewhere")
    settings = result["settings"]
    assert settings["mixed-soft_start-0"].keys() == CONTROLLERS["soft_start"].bounds.keys()
    assert settings["mixed-given-0"] == {"speed": 0.2}


def test_arms_are_trained_by_the_config_and_judged_as_they_drive(finished):
    """The numbers are those of the saved models and settings on the held-out courses, in the world
    of the scenario.
    """
    asked = cells.load_study(Study, finished)
    result = read(finished)
    settings = result["settings"]["mixed-soft_start-0"]
    runs = [finished / "trained" / f"mixed-identified-{k}" for k in (0, 1)]
    for name, target in asked.targets.items():

        def drive(controller, target=target):
            """Mean return of a controller on the held-out courses of the target."""
            return run_courses(
                controller, target.scenario, asked.held_out, 6, model=target.world
            ).returns.mean()

        by_seed = {arm: own["return"] for arm, own in result["scenarios"][name]["by_seed"].items()}
        agents = [load_model(run / "model.zip", target.scenario) for run in runs]
        assert by_seed["identified"] == pytest.approx([drive(agent) for agent in agents])
        soft = make_controller("soft_start", target.scenario, **settings)
        assert by_seed["soft_start"] == [pytest.approx(drive(soft))]
        assert by_seed["true_soil"][0] != by_seed["true_soil"][1]
    (first, task), (second, _) = map(open_run, runs)
    assert (first.hidden_worlds, first.ppo.history, task.control.time_limit) == (1, 2, 6.0)
    assert abs(first.seed - second.seed) > 65536  # wheel k of a training has seed + k
    assert asked.targets["elsewhere"].world.effects == WheelSoilModel.load(WORLD).effects


@pytest.mark.usefixtures("unrendered")
@pytest.mark.parametrize("elsewhere", [False, True])
def test_lost_cells_are_done_again_and_give_the_same(finished, copied, elsewhere):
    """The work can be sent to other processes and, with `elsewhere`, to machines that do not share
    the folder. There the model of a lost cell is made again although it is here.
    """
    for name in ("mixed-true_soil-1", "mixed-full_throttle-0", "mixed-identified-0"):
        (copied / "cells" / f"{name}.json").unlink()
    run = copied / "trained" / "mixed-identified-0"
    shutil.rmtree(run)
    run.mkdir()  # as a kill leaves it that comes while the folder is begun
    for name in ("config.yaml", BEGUN.format("config")):
        (run / name).touch()
    kept = copied / "trained" / "mixed-true_soil-1" / "model.zip"
    before = kept.stat().st_mtime_ns

    def sent(do, missing):
        """Engine that sends the work as other processes get it, pickled."""
        return cells.in_process(pickle.loads(pickle.dumps(do)), missing)

    work.fill(cells.load_study(Study, copied), copied, sent, elsewhere)
    assert (kept.stat().st_mtime_ns == before) != elsewhere
    assert load_agent(run).info.observation == "identified"
    assert main(["--out", copied, "--report"]) == 0
    assert (copied / "study.json").read_bytes() == (finished / "study.json").read_bytes()


def test_other_shipped_settings_are_other_cells(tmp_path, monkeypatch):
    """Settings of configs/tuned count where a tuning may take them: not in a study of worlds, nor
    where the arm has its own.
    """

    def needs(worlds, settings):
        arm = {"controller": "fixed_slip", "settings": settings}
        content = {"controllers": [], "arms": {"rule": arm}, "worlds": worlds}
        asked = read_config(config(tmp_path, scenarios={"mixed": {}}, **content))
        return [work.Work(asked, tmp_path).needs(cell) for cell in asked.cells()]

    cases = ({}, {}), ({}, {"slip": 0.3}), ({"hidden": {"model": "effect.yaml"}}, {})
    before = [needs(*case) for case in cases]
    monkeypatch.setattr(work, "shipped_settings", lambda *_: {"fixed_slip": {"slip": 0.2}})
    after = [needs(*case) for case in cases]
    assert [a == b for a, b in zip(before, after, strict=True)] == [False, True, True]


@pytest.mark.usefixtures("unrendered")
def test_a_study_grows_by_seeds_and_by_nothing_else(finished, copied, tmp_path, capsys):
    longer = ["--train.timesteps", "100"]
    asked = ["--config", config(tmp_path)]
    for out, given, said in (
        (copied, [*asked, "--tuning_courses", "2"], "tuning_courses"),
        (copied, [*asked, *longer], "arms"),
        (copied, ["--sedes", "3"], "option --sedes; did you mean '--seeds'?"),
        (copied, longer, "only with --config"),
        (copied / "cells", asked, "holds no study"),
        (tmp_path / "none", [], "no such folder"),
    ):
        assert said in refused(capsys, *given, "--out", out)
    study = copied / "study.yaml"
    begun = study.read_text()
    study.write_text(begun.replace("version: 0.1.0+", "version: 0.0.9+"))
    assert "its agents were trained with soil_env 0.0.9+" in refused(capsys, "--out", copied)
    study.write_text(begun)
    assert main(["--out", copied, "--seeds", "3"]) == 0
    old, new = (
        read(f)["scenarios"]["mixed"]["by_seed"]["true_soil"]["return"] for f in (finished, copied)
    )
    assert len(new) == 3 and new[:2] == old


def test_a_file_of_the_user_in_the_folder_is_named(tmp_path, capsys):
    own = config(tmp_path)
    said = refused(capsys, "--config", own, "--out", tmp_path)
    assert f"{own}: is a file of yours" in said and "give another --out, or move the file" in said


def test_results_of_an_unfinished_study(copied, capsys):
    (copied / "cells" / "mixed-true_soil-1.json").unlink()
    assert main(["--out", copied, "--report"]) == 0
    assert read(copied)["scenarios"]["mixed"]["members"]["true_soil"] == 1
    shutil.rmtree(copied / "cells")
    assert "no cell is done" in refused(capsys, "--out", copied, "--report")


def test_an_arm_is_made_in_its_world(tmp_path):
    """Without a world in that of its scenario; of a model that discovery has fitted only the
    effects count.
    """
    term = ResidualTerm("drawbar_pull", -0.04, {"slip": 1.0}, {"slip": [0.1, 0.3]})
    effects = {"bulldozing": {"rankine": 1.0}}
    fitted = WheelSoilModel(ModelWheel(0.15, 0.15), soils()["dry_sand"], effects, (term,))
    fitted.save(tmp_path / "found.yaml")
    arms = {"plain": {"world": "none"}, "corrected": {"world": "found"}, "own": {}}
    worlds = {"none": {}, "found": {"model": "found.yaml"}}
    scenarios = {"mixed": {"model": "effect.yaml"}}
    changes = {"worlds": worlds, "scenarios": scenarios, "controllers": [], "seeds": 1}
    path = config(tmp_path, arms=arms, **changes)
    assert main(["--config", path, "--out", tmp_path / "out"]) == 0
    runs = tmp_path / "out" / "trained"
    plain, found, own = (open_run(runs / f"mixed-{name}-0")[0].world for name in arms)
    assert plain is None and list(own.effects["bulldozing"]) == ["hegedus"]
    assert (found.effects, found.soil, found.residual) == (fitted.effects, None, ())
    assert read(tmp_path / "out")["worlds"] == {"none": {}, "found": fitted.effects}


def test_a_study_of_a_rover(tmp_path):
    path = config(
        tmp_path,
        seeds=1,
        scenarios={"moon": {"rover": "lunar_micro_rover"}},
        arms={"blind": {"train": {"observation": "blind"}}},
        controllers=["torque_by_load"],
    )
    assert main(["--config", path, "--out", tmp_path / "out"]) == 0
    entry = read(tmp_path / "out")["scenarios"]["moon"]
    assert list(entry["controllers"]) == ["torque_by_load", "blind"]
    assert "fighting" in entry["metrics"]
    assert "wheel_force" in entry["paired"]["blind"]["torque_by_load"]


@pytest.mark.parametrize("name", sorted(p.name for p in config_dir().glob("study*.yaml")))
def test_the_shipped_configs_can_be_read(name):
    study = read_config(config_dir() / name)
    assert study.compared_with in study.arms and len(study.cells()) > 3
    if name == "study.yaml":
        assert CONTROLLERS.keys() < study.arms.keys()
        assert study.fed_by("mixed") == ["mixed", "unseen"]
        mixed, unseen = (study.targets[name] for name in ("mixed", "unseen"))
        assert unseen.world is not None
        assert not mixed.scenario.soils.keys() & unseen.scenario.soils.keys()
    if name == "study_rover.yaml":
        assert ROVER_CONTROLLERS.keys() < study.arms.keys()


@pytest.mark.parametrize(
    "changes, said",
    [
        ({"scenarios": {"mixd": {}}}, "study.yaml: scenarios.mixd: scenario: unknown value"),
        ({"scenarios": {"mixed": {}, "unseen": {"trained_on": "stiky"}}}, "stiky"),
        (
            {"scenarios": {"mixed": {"changes": {"course": {"lenght": 1}}}}},
            "study.yaml: scenarios.mixed.changes",
        ),
        ({"arms": {}, "controllers": []}, "one arm"),
        ({"arms": {"a-b": {}}}, "a-b"),
        (
            {"controllers": ["soft_start"], "arms": {"soft_start": {"controller": "best_route"}}},
            "study.yaml: arms.soft_start: expected another name: one of controllers has this one",
        ),
        ({"arms": {"a": {"train": {"seed": 1}}}}, "arms.a.train.seed: the study sets it"),
        ({"arms": {"a": {"controller": "soft_start", "train": {"seed": 1}}}}, "not both"),
        ({"arms": {"a": {"settings": {"slip": 0.2}}}}, "arms.a.settings: an agent has none"),
        (
            {
                "scenarios": {"two_lines": {}, "mixed": {"trained_on": "two_lines"}},
                "arms": {"a": {}},
            },
            "scenarios.mixed: trained_on: 'two_lines' has other observations or actions",
        ),
        (
            {"arms": {"a": {"world": "nowhere"}}},
            "arms.a: world: unknown value 'nowhere' (expected none)",
        ),
        ({"arms": {"a": {"controller": "nomod:Thing"}}}, "nomod:Thing: cannot be imported"),
        (
            {
                "scenarios": {"r": {"rover": "mars_rover"}},
                "controllers": [],
                "arms": {"a": {"controller": "soft_start", "settings": {"name": 3}}},
            },
            "arms.a.settings: unknown key 'name'",
        ),
        ({"held_out": 1_000_001}, "held_out = 1000001: controllers are tuned on this set"),
        ({"sead": 1}, "study.yaml: unknown key 'sead'; did you mean 'seeds'"),
        ({"controllers": 5}, "study.yaml: controllers = 5: expected a list of names"),
        ({"controllers": None}, "study.yaml: controllers = None: expected a list of names"),
        ({"controllers": [{}]}, "study.yaml: controllers = [{}]: expected a list of names"),
        ({"arms": {"a": {"train": 3}}}, "study.yaml: arms.a.train = 3: expected a mapping"),
    ],
)
def test_a_bad_config_is_refused_in_one_line(tmp_path, capsys, changes, said):
    out = tmp_path / "out"
    assert said in refused(capsys, "--config", config(tmp_path, **changes), "--out", out)
    assert not out.exists()


def test_bad_worlds_are_refused_in_one_line(tmp_path, capsys):
    path = config(tmp_path, scenarios={"mixed": {"model": "effect.yaml"}})
    world = yaml.safe_load((tmp_path / "effect.yaml").read_text())
    for changes, expected in (
        ({"effects": {}}, "no effects"),
        ({"wheel": {"radius": 0.3, "width": 0.15}}, "that of scenario"),
        ({"soil": dataclasses.asdict(soils()["dry_sand"])}, "expected no soil"),
    ):
        (tmp_path / "effect.yaml").write_text(yaml.safe_dump(world | changes))
        assert expected in refused(capsys, "--config", path, "--out", tmp_path / "out")
        assert not (tmp_path / "out").exists()
