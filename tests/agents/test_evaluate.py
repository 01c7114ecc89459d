"""`soil-env evaluate`: its files, going on after a kill, bad input in one line, and drives against
a plain loop.
"""

import csv
import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import yaml
from scipy import stats

from soil_env._io.loading import load, to_dict
from soil_env.cli import main as soil_env
from soil_env.envs.wheels import Simulation
from soil_env.parameters import load_scenario
from soil_env.simulation.task import Cause
from soil_env_agents import cells
from soil_env_agents.controllers import make_controller
from soil_env_agents.evaluate import command, comparing, own, report
from soil_env_agents.evaluate.contestants import model_bytes, parse
from soil_env_agents.evaluate.driving import (
    HELD_OUT_SET,
    METRICS,
    RATES,
    Runs,
    course_rng,
    run_courses,
)
from soil_env_agents.evaluate.evaluation import Evaluation
from soil_env_agents.evaluate.loading import check, load as load_contestant
from soil_env_agents.evaluate.own import code_digest
from soil_env_agents.evaluate.statistics import wilson
from tests.agents.drivers import Counting, Half
from tests.agents.learnt import saved
from tests.conftest import ROOT
from tests.programs import python
from tests.refusals import refused, refused_command

DRIVERS = "tests.agents.drivers"
RULES = "soil_env_agents.controllers.wheel"
FIXED = "--settings.fixed_slip.slip=0.2"
SHORT = (
    "--changes.control.time_limit=6 --changes.course.length=2 --courses=7 --block=3 --resamples=50 "
    "--seed=11 --tuning-courses=0"
).split()


def main(*arguments):
    """Exit status of `soil-env evaluate`."""
    return soil_env(["evaluate", *arguments])


def evaluate(out, controllers, *more):
    """Status of a short evaluation; an option in `more` replaces the usual one."""
    later = {option.partition("=")[0] for option in more}
    short = [option for option in SHORT if option.partition("=")[0] not in later]
    return main(f"--controllers={controllers}", f"--out={out}", *short, *more)


def refusal(capsys, *arguments):
    """The line of a refused evaluation."""
    return refused_command(capsys, "soil-env evaluate", soil_env, "evaluate", *arguments).err


def result_of(folder):
    """evaluation.json, without constants that JSON does not have."""
    return json.loads((folder / "evaluation.json").read_text(), parse_constant=pytest.fail)


def same(a, b):
    """Assert that two folders hold the same results, to the byte."""
    done = sorted(f"cells/{p.name}" for p in (a / "cells").iterdir())
    assert done == sorted(f"cells/{p.name}" for p in (b / "cells").iterdir())
    for name in ("evaluation.json", "evaluation.md", "courses.csv", "metrics.png", *done):
        assert (a / name).read_bytes() == (b / name).read_bytes(), name


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """Folder of two training seeds of an agent, as train.py leaves them, with hardly any
    training.
    """
    folder = tmp_path_factory.mktemp("models")
    for seed in (0, 1):
        saved(folder / f"seed_{seed}", load_scenario(), "blind", seed, history=7)
    return folder


@pytest.fixture(scope="module")
def everyone(models):
    """Two classes, a classical controller and two training seeds."""
    return f"half={DRIVERS}:Half,{DRIVERS}:Counting,fixed_slip,ppo={models}/seed_*"


@pytest.fixture(scope="module")
def done(everyone, tmp_path_factory):
    """A finished evaluation of `everyone`."""
    out = tmp_path_factory.mktemp("done") / "made" / "here"
    assert evaluate(out, everyone, FIXED) == 0
    return out


def runs_of(returns, finished=True):
    """`Runs` with these returns [courses], each finished or else bogged; all other values are 1."""
    returns = np.asarray(returns, dtype=float)
    ended = np.where(np.full(returns.shape, finished), Cause.FINISHED.value, Cause.BOGGED.value)
    return Runs(ended, *np.ones((5, returns.size)), returns)


def test_a_comparison_of_known_runs():
    """Two training seeds of `a`, one of `b`, whose return is 1 below their mean on every course; a
    quarter of `a` is bogged.
    """
    rng = np.random.default_rng(0)
    scenario = load_scenario("mixed")
    returns = rng.normal(5.0, 2.0, (2, 40))
    finished = np.arange(40) >= 10
    runs = {
        "a": [runs_of(row, finished) for row in returns],
        "b": [runs_of(returns.mean(axis=0) - 1.0)],
    }
    found = comparing.comparison(scenario, 3, runs, resamples=400)
    assert found["members"] == {"a": 2, "b": 1}
    assert (found["courses"], found["scenario"]) == (40, "mixed")
    a = found["controllers"]["a"]
    b = found["controllers"]["b"]
    assert a["finished"]["value"] == pytest.approx(0.75)
    assert a["immobilised"]["value"] == pytest.approx(0.25)
    assert (b["finished"]["low"], b["finished"]["high"]) == pytest.approx(wilson(40, 40))
    assert found["by_seed"]["a"]["return"] == pytest.approx(returns.mean(axis=1))
    assert found["iqm"]["a"]["value"] == pytest.approx(stats.trim_mean(returns, 0.25, axis=None))
    paired = found["paired"]["a"]["b"]
    assert paired["return"]["value"] == pytest.approx(1.0)
    assert paired["finished"]["value"] == pytest.approx(-0.25)
    assert paired["return"]["low"] <= 1.0 <= paired["return"]["high"]
    assert found["paired"]["b"]["a"]["return"]["high"] == pytest.approx(-paired["return"]["low"])
    p = found["improvement"]["a"]["b"]
    q = found["improvement"]["b"]["a"]
    assert (p["value"], p["low"]) == pytest.approx((1.0 - q["value"], 1.0 - q["high"]))
    assert found == comparing.comparison(scenario, 3, runs, resamples=400)


def test_values_are_means_over_the_courses_that_are_listed(done):
    result = result_of(done)
    rows = list(csv.DictReader((done / "courses.csv").read_text().splitlines()))
    assert len(rows) == 7 * 5  # courses and drivers: two classes, a rule, two training seeds
    for name, metrics in result["controllers"].items():
        own = [row for row in rows if row["controller"] == name]
        assert len(own) == 7 * result["members"][name]
        for metric in set(result["metrics"]) - set(RATES):
            values = [float(row[metric]) for row in own if row[metric]]
            expected = pytest.approx(np.mean(values), rel=1e-4, abs=1e-9) if values else None
            assert metrics[metric]["value"] == expected
        for cause in ("ENTRAPPED", "STALLED", "BOGGED", "TIME_LIMIT", "FINISHED"):
            share = np.mean([row["cause"] == cause for row in own])
            assert metrics[cause.lower()]["value"] == pytest.approx(share)


def test_settings_are_tuned_once_and_drive_the_held_out_courses_of_train(tmp_path, capsys):
    short = {"course": {"length": 2.0}, "control": {"time_limit": 6.0}}
    scenario = load_scenario("two_lines", short)
    out = tmp_path / "out"
    asked = [option for option in SHORT if not option.startswith(("--tuning", "--seed"))]
    asked += ["--controllers=fixed_slip,constant_speed,full_throttle", f"--out={out}"]
    asked += ["--tuning-courses=2", "--settings.constant_speed.speed=0.3"]
    assert main(*asked) == 0
    assert "Tuning: 2 of 2 courses" in capsys.readouterr().out  # on 2 courses there is one trial
    kept = yaml.safe_load((out / "study.yaml").read_text())["tuned"]
    result = result_of(out)
    assert set(kept) == {"fixed_slip"} and set(kept["fixed_slip"]) == {"slip", "start", "speed"}
    settings = {**kept, "constant_speed": {"speed": 0.3}, "full_throttle": {}}
    assert result["settings"] == settings and result["chosen"]["fixed_slip"] == "tuned"
    for name, row in result["controllers"].items():
        controller = make_controller(name, scenario, **settings[name])
        theirs = run_courses(controller, scenario, HELD_OUT_SET, 7)
        expected = {metric: theirs.metric(metric).mean() for metric in METRICS}
        found = {metric: row[metric]["value"] for metric in METRICS}
        assert found == pytest.approx(expected, rel=1e-12), name
    assert main(*asked) == 0 and "Tuning" not in capsys.readouterr().out


def test_a_module_in_the_current_folder_is_found(tmp_path, monkeypatch):
    """An object, its class, and a function that returns it drive alike."""
    (tmp_path / "mine_of_test.py").write_text(
        f"from {DRIVERS} import Half\nhalf = Half()\ndef make(scenario):\n    return half\n"
    )
    monkeypatch.chdir(tmp_path)
    three = ",".join(f"{f}=mine_of_test:{f}" for f in ("make", "half", "Half"))
    assert evaluate(tmp_path / "out", three) == 0
    rows = result_of(tmp_path / "out")["controllers"]
    assert rows["make"] == rows["half"] == rows["Half"]


def test_effects_of_a_world_and_the_limit_of_the_oracle(tmp_path, capsys):
    """`limit` has what the oracle finishes of the first courses, and `nobody`, the numbers of those
    that neither it nor a controller finishes.
    """
    world = ROOT / "configs/worlds/bulldozing.yaml"
    more = [f"--model={world}", "--oracle-courses=2", "--courses=3"]
    assert evaluate(tmp_path / "with", "soft_start", *more) == 0
    page = (tmp_path / "with" / "evaluation.md").read_text()
    for text in (capsys.readouterr().out, page):
        assert "in a world with bulldozing" in text
        assert "[-]" not in text
    assert evaluate(tmp_path / "without", "soft_start", "--courses=3") == 0
    assert "in a world" not in capsys.readouterr().out
    there = result_of(tmp_path / "with")
    plain = result_of(tmp_path / "without")
    assert list(there["model"]["effects"]) == ["bulldozing"]
    assert not {"model", "limit"} & plain.keys()
    returns = [found["controllers"]["soft_start"]["return"] for found in (there, plain)]
    assert returns[0] != returns[1]
    limit = there["limit"]
    finished = limit["metrics"]["finished"]["value"]
    assert limit["courses"] == 2 and finished in (0.0, 0.5, 1.0)
    rows = csv.DictReader((tmp_path / "with" / "courses.csv").read_text().splitlines())
    failed = {k for k, row in enumerate(rows) if row["cause"] != "FINISHED"}
    assert set(limit["nobody"]) <= failed & {0, 1}
    assert len(limit["nobody"]) <= 2.0 - 2.0 * finished
    assert "Of the first 2 courses" in page and "oracle (first 2 courses)" in page


class Killed(BaseException):
    """Ends an evaluation at once, as kill -9 does: nothing catches it."""


def test_a_kill_and_processes_give_the_same_table(tmp_path, monkeypatch, importable):
    """Killed in the middle of a block; then two processes do the rest."""
    out = tmp_path / "out"
    calm = tmp_path / "calm"
    predict = Counting.predict

    def killed(self, *given, **more):
        """`predict` that ends all at the call after the fortieth of an object."""
        if self.calls == 40:
            raise Killed
        return predict(self, *given, **more)

    asked = [
        *SHORT,
        "--changes.control.action=torque",
        f"--controllers=half={DRIVERS}:Half,{DRIVERS}:Counting",
    ]
    with monkeypatch.context() as patch, pytest.raises(Killed):
        patch.setattr(Counting, "predict", killed)
        main(*asked, f"--out={out}")
    (first,) = (out / "cells").iterdir()
    assert main("--resume", str(out)) == 2  # a file alone does not name code to be run
    before = first.stat().st_mtime_ns
    assert (
        main("--resume", str(out), "--workers=2", "--allow-code") == 0
        and first.stat().st_mtime_ns == before
    )
    assert main(*asked, f"--out={calm}") == 0
    same(out, calm)


def test_results_that_cannot_all_be_written_are_not_there(tmp_path, monkeypatch):
    """evaluation.json among them, by which train.py knows that a comparison is done."""

    def full(*_):
        """Drawing on a disk without room."""
        raise OSError(28, "full", "metrics.png")

    monkeypatch.setattr(report, "draw_metrics", full)
    assert main(*SHORT, "--controllers=full_throttle", f"--out={tmp_path / 'out'}") == 2
    assert not [p for p in (tmp_path / "out").glob("[!.]*.*") if p.name != "study.yaml"]


@pytest.mark.parametrize("controllers", [["a"], {"a": 3}, None])
def test_a_damaged_study_is_refused_in_one_line(controllers, tmp_path, capsys):
    (tmp_path / cells.STUDY).write_text(yaml.safe_dump({"controllers": controllers}))
    assert f"{cells.STUDY}: controllers" in refusal(capsys, "--resume", tmp_path)


def test_tuned_settings_that_are_no_mapping_are_refused():
    task = to_dict(load_scenario("mixed"))
    content = {"task": task, "controllers": {}, "tuned": {"soft_start": 3}}
    refused(lambda: load(Evaluation, content, "study.yaml"), "tuned.soft_start = 3", "a mapping")


def test_ray_gives_what_one_process_gives(cluster, everyone, done, tmp_path):
    """The models travel with the cells."""
    asked = [f"--controllers={everyone}", FIXED, *SHORT, "--engine=ray", f"--out={tmp_path}"]
    python("-m", "soil_env.cli", "evaluate", *asked, f"--address={cluster.address}")
    same(tmp_path, done)


#: Module with a class that has a setting.
BOUNDED = """
import numpy as np
from soil_env_agents.controllers import Setting

class Bounded:
    variant = "blind"
    bounds = {"slip": Setting(0.2, "1", "slip", (0.1, 0.4))}

    def __init__(self, scenario, slip=0.2):
        self.slip = slip

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.full((len(observation), 1), self.slip), state
"""


def test_an_edited_class_or_study_is_driven_again(capsys, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    module = tmp_path / "driver_of_a_test.py"
    module.write_text(BOUNDED)
    out = tmp_path / "out"
    asked = [*SHORT, "--controllers=mine=driver_of_a_test:Bounded,soft_start", f"--out={out}"]
    assert main(*asked) == 0
    # Of each controller the first block of courses.
    rule, mine = (out / "cells" / f"{n}-0-0.json" for n in ("soft_start", "mine"))
    before = [p.stat().st_mtime_ns for p in (rule, mine)]
    module.write_text(BOUNDED + "\n# edited\n")
    assert main(*asked) == 0 and "done again" in capsys.readouterr().out
    after = [p.stat().st_mtime_ns for p in (rule, mine)]
    assert after[0] == before[0] and after[1] > before[1]
    study = out / "study.yaml"
    # A digit more: 12 m in place of 2.
    study.write_text(study.read_text().replace("length: ", "length: 1", 1))
    assert main("--resume", str(out), "--allow-code") == 0
    assert rule.stat().st_mtime_ns > after[0]


def test_the_code_of_a_class_is_its_module_and_what_of_the_users_it_imports(tmp_path, monkeypatch):
    """Imports in a function, in a package with or without __init__.py, and relative ones count.
    What is installed or missing does not, nor does a folder with the name of a library.
    """
    monkeypatch.syspath_prepend(str(tmp_path))
    files = {
        "drivers_of_mine/mine.py": f"import helper_of_mine, yaml, no_such_module\n{BOUNDED}",
        "drivers_of_mine/near.py": "X = 1\n",
        "helper_of_mine.py": "def f():\n    from package_of_mine import values as v\n",
        "package_of_mine/__init__.py": "from . import of_init\n",
        "package_of_mine/of_init.py": "X = 1\n",
        "package_of_mine/values.py": "from .deep.down import X\n",
        "package_of_mine/deep/down.py": "from ...helper_of_mine import f\nimport not_read\n",
    }
    source = "drivers_of_mine.mine:Bounded"
    for name, text in {**files, "yaml/readme.txt": "", "other.py": ""}.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    # After an edit of each file in turn, all digests differ but that of the file beside, which
    # nothing imports.
    found = [code_digest(source)]
    for name in files:
        with open(tmp_path / name, "a") as file:
            file.write("Y = 2\n")
        found.append(code_digest(source))
    unread = list(files).index("drivers_of_mine/near.py")
    assert found.pop(unread) == found[unread] and len({*found}) == len(found) and "" not in found
    (tmp_path / "other.py").write_text("X = 1\n")
    assert code_digest(source) == found[-1]
    # An import that cannot be parsed counts by its bytes, and is not followed.
    (tmp_path / "helper_of_mine.py").write_text("not Python")
    broken = code_digest(source)
    (tmp_path / "drivers_of_mine/mine.py").write_text(f"import helper_of_mine\n{BOUNDED}# edited")
    assert len({"", found[-1], broken, code_digest(source)}) == 4
    assert code_digest("no_such_module:Bounded") == "" != code_digest("yaml:YAMLObject")


def test_a_class_gets_the_scenario_where_it_names_it():
    """An optional number of a class is not the scenario."""
    mixed = load_scenario("mixed")
    ramp, knowing = (own.made(f"{DRIVERS}:{x}", mixed, {}, "") for x in ("Ramp", "Knowing"))
    assert ramp.rate == 0.1 and knowing.scenario is mixed


def test_a_model_that_has_changed_is_refused_and_other_code_drives_again(capsys, tmp_path, models):
    mine = tmp_path / "model.zip"
    out = tmp_path / "out"
    shutil.copy(models / "seed_0" / "model.zip", mine)
    assert evaluate(out, f"ppo={mine}", "--courses=2") == 0
    shutil.copy(models / "seed_1" / "model.zip", mine)
    changed = "the model has changed since the study began"
    assert changed in refusal(capsys, "--resume", out)
    shutil.copy(models / "seed_0" / "model.zip", mine)
    text = (out / "study.yaml").read_text()
    assert f"version: {cells.code_version()}\n" in text
    (out / "study.yaml").write_text(text.replace("version: 0.1.0+", "version: 0.0.9+"))
    cell = out / "cells" / "ppo-0-0.json"
    content = json.loads(cell.read_text())
    cell.write_text(json.dumps({**content, cells.MADE_FROM: "other code"}))
    before = cell.stat().st_mtime_ns
    assert main("--resume", str(out)) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "begun with soil_env 0.0.9+" in said and "what is done counts no more" in said
    assert cell.stat().st_mtime_ns > before and (out / "study.yaml").read_text() == text


def test_what_other_code_or_another_class_tuned_is_tuned_again(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    module = tmp_path / "bounded_of_a_test.py"
    module.write_text(BOUNDED)
    out = tmp_path / "out"
    controllers = "mine=bounded_of_a_test:Bounded,fixed_slip"
    assert evaluate(out, controllers, "--tuning-courses=2", "--courses=2") == 0

    def tuned(study):
        """Names of the controllers that a tuning of the study asks for; each gets a slip of 0.3."""
        names = []

        def found(scenario, courses, of, world, log):
            """Stand-in for `tuned_settings`: notes the controllers `of` and drives nothing."""
            names.extend(of)
            return {name: {"slip": 0.3} for name in of}

        monkeypatch.setattr(command, "tuned_settings", found)
        command._tuned(study, out)
        return names

    study = cells.load_study(Evaluation, out)
    assert tuned(study) == []
    assert tuned(study.renewed("0.0.9")) == ["bounded_of_a_test:Bounded", "fixed_slip"]
    for edited in ({"tuning_courses": 3}, {"task": study.task | {"name": "another"}}):
        assert len(tuned(replace(study, **edited))) == 2
    module.write_text(BOUNDED + "\n# edited\n")
    assert tuned(study) == ["bounded_of_a_test:Bounded"]
    monkeypatch.setattr(command, "shipped_settings", lambda *_: {"fixed_slip": {"slip": 0.2}})
    assert "fixed_slip" in tuned(study)  # configs/tuned was edited


REFUSED = {  # controllers: parts of the message, between " ... "
    "fixd_slip": "'fixd_slip' ... did you mean 'fixed_slip'?",
    "missing.zip": "missing.zip ... No such file",
    __file__: "test_evaluate.py: no trained agent: expected a run folder ... a controller",
    "{models}/seed_*": "2 models ... NAME=",
    "{models}/seed_0,{models}/seed_0": "'seed_0' twice",
    "a={models}/seed_0,a={models}/seed_*": "'a': {models}/seed_0/model.zip twice",
    "oracle": "--oracle-courses N",
    f"{DRIVERS}:Halve": "'Halve' ... did you mean 'Half'?",
    f"{DRIVERS}:NoPredict": "no method predict",
    f"{DRIVERS}:WrongShape": "drivers:WrongShape ... of shape [3]: expected [3, 1]",
    f"{DRIVERS}:Complex": "an action that is no number: expected shape",
    f"{DRIVERS}:Huge": "an action that is no number: expected shape",
    f"{DRIVERS}:Alone": "predict gave one value: expected (action, state)",
    f"{DRIVERS}:OneNaN": "predict gave nan for observation 1: expected finite numbers",
    f"{DRIVERS}:OtherVariant": "'blnd' ... blind, identified, true_soil",
    f"{DRIVERS}:Raises": "OSError: no such device ... drivers.py line",
    f"{DRIVERS}:Exits": "drivers:Exits: predict failed (SystemExit ... drivers.py line",
    f"{DRIVERS}:ExitsWhenMade": "cannot be made (SystemExit: no licence",
}
REFUSED_OPTIONS = {
    "--oracle-courses=9": "--oracle-courses = 9",
    "--settings.full_throttle.slip=0.1": "full_throttle has no settings",
    "--changes.course.lenght=2": "lenght ... did you mean 'length'?",
    "--settings=3": "--settings: expected --settings.KEY VALUE",
    "--controllers=my-c.d=soft_start --settings.my-c.d.sped=1": "'sped' ... 'speed'",
    "--model=": "model = '': expected the path of a model.yaml",
    "--tuning-courses=2 --seed=1000001": "--seed 1000001 ... tuned on",
    f"--tuning-courses=2 --controllers=mine={RULES}:SoftStart,mine={RULES}:FixedSlip": (
        "'mine': 2 classes to tune: expected a name for each"
    ),
    "--resume={models}": "takes only the engine",
    "--controler=fixed_slip": "unknown option --controler; did you mean '--controllers'?",
}


@pytest.mark.parametrize(
    "options, said",
    [
        *((f"--controllers={name}", said) for name, said in REFUSED.items()),
        *REFUSED_OPTIONS.items(),
        ("", "expected --controllers and --out"),
    ],
)
def test_bad_input_is_refused_in_one_line_and_nothing_is_written(
    capsys, tmp_path, models, options, said
):
    more = options.format(models=models).split()
    if options and "--control" not in options:
        more.append("--controllers=full_throttle")
    given = [option for option in SHORT if option.split("=")[0] not in options]
    error = refusal(capsys, *given, *more, f"--out={tmp_path / 'out'}")
    assert len(error) < 700
    assert all(part in error for part in said.format(models=models).split(" ... ")), error
    assert not list(tmp_path.iterdir())


def test_models_of_one_name_read_one_observation(capsys, tmp_path, models):
    other = saved(tmp_path / "other", load_scenario(), "identified")
    asked = f"ppo={models}/seed_0,ppo={other}"
    assert evaluate(tmp_path / "out", asked, "--courses=2") == 2
    said = capsys.readouterr().err
    assert "reads the observation 'identified', another of the name 'blind': expected" in said


def test_a_glob_finds_models_once_and_names_runs_whose_training_is_not_done(capsys, tmp_path):
    for run in ("done/comparison", "killed"):
        (tmp_path / run).mkdir(parents=True)
    for name in ("killed/config.yaml", "done/config.yaml", "done/comparison/evaluation.json"):
        (tmp_path / name).touch()
    model = tmp_path / "done" / "model.zip"
    model.touch()
    killed = f"left out {tmp_path / 'killed'}: training is not done."
    for pattern, ends in (("*", killed), ("**", killed), ("*/model.zip", killed), ("done/*", "")):
        (found,) = parse(f"a={tmp_path}/{pattern}").values()
        assert found.source == str(model)
        said = " ".join(capsys.readouterr().out.split())
        assert said.endswith(ends) and bool(said) == bool(ends)
    refused(lambda: parse(f"a={tmp_path}/k*"), "no model matches; ", "killed: training is not done")
    refused(lambda: model_bytes(str(tmp_path / "killed" / "model.zip")), "training is not done")
    for other in ("killed/modle.zip", "done/comparison"):
        refused(lambda other=other: model_bytes(str(tmp_path / other)), "cannot be read")


def test_a_controller_that_fails_on_the_way_is_named(capsys, tmp_path):
    """What was done before is kept; where nothing was, nothing is left."""
    out = tmp_path / "out"
    late = f"mine={DRIVERS}:LateNaN"
    assert evaluate(out, f"full_throttle,{late}") == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "action nan in step 3" in error and late[5:] in error
    assert len(list((out / "cells").iterdir())) == 1
    resume = f"soil-env evaluate --resume {out} --allow-code"
    assert error.endswith(f"keeps what is done; once that is mended go on with: {resume}\n")
    (tmp_path / "empty").mkdir()
    for name in ("new", "empty"):
        assert evaluate(tmp_path / name, late) == 2
        assert "keeps" not in capsys.readouterr().err
    assert {p.name for p in tmp_path.iterdir()} == {"out", "empty"}
    assert not list((tmp_path / "empty").iterdir())


TASK = load_scenario("mixed", {"control": {"time_limit": 25.0, "action": "torque"}})
SEED = 12345


@pytest.mark.parametrize(
    "name", ["full_throttle", "fixed_slip", "best_slip_identified", "best_slip_true"]
)
def test_runs_equal_a_loop_over_one_wheel(name):
    """Each metric of six courses driven side by side, against its definition over the states of a
    wheel that drives one of them alone.
    """
    controller = make_controller(
        name, TASK, **({"slip": 0.45, "start": 0.15} if name == "fixed_slip" else {})
    )
    got = run_courses(controller, TASK, SEED, 6, detailed=True)
    every = vars(got) | {name: got.metric(name) for name in got.names}
    pulled = 0
    for course in range(6):
        sim = Simulation(1, TASK, controller.variant, threads=1)
        sim.seed(0, course_rng(SEED, course))
        sim.restart(0)
        w = sim.worlds
        rows = []
        returns = 0.0
        state = None
        while w.cause[0] == Cause.RUNNING.value:
            action, state = controller.predict(
                w.observation.copy(), state, np.array([state is None])
            )
            sim.step(0, float(action[0, 0]))
            returns += float(w.terms[0].sum())
            rows.append(w.state[0].copy())
        seen = np.array(rows)
        work = seen["motor_work"]
        pull = seen["drawbar_pull"]
        furthest = seen["best_x"].max()
        # furthest within a period, from which a braked wheel may roll back by its end
        assert 0.0 <= furthest - max(seen["x"].max(), 0.0) < 1e-3
        assert got.cause[course] == w.cause[0]
        under_way = seen["halt_left"] == 0.0
        pulls = under_way & (pull > 0.0) & (work > 0.0)
        expected = {
            "time": 0.1 * len(rows),
            "distance": max(furthest, 0.0),
            "energy": np.maximum(work, 0.0).sum(),
            "return": returns,
            "sinkage": 1000.0 * seen["sinkage"].mean(),
            "slip": seen["slip"][under_way].mean(),
        }
        expected["speed"] = expected["distance"] / expected["time"]
        expected["energy_per_metre"] = expected["energy"] / max(expected["distance"], 0.1)
        for metric, unit in (("slip", 1.0), ("sinkage", 1000.0)):
            for q in (50, 95):
                seen_there = unit * seen[metric][under_way]
                expected[f"{metric}_p{q}"] = np.quantile(seen_there, q / 100)
        found = {key: every[key][course] for key in expected}
        assert found == pytest.approx(expected, rel=1e-9)
        efficiency = every["tractive_efficiency"][
            course
        ]  # NaN where the wheel rolls downhill all the way
        if pulls.any():
            useful = np.maximum(pull * seen["travel"], 0.0)[pulls]
            assert efficiency == pytest.approx(useful.sum() / work[pulls].sum())
            assert 0.0 < efficiency < 1.0
        assert np.isfinite(efficiency) == pulls.any()
        pulled += pulls.any()
    assert pulled > 2


def test_return_is_compared_without_the_information_that_an_agent_was_paid_for():
    paid = load_scenario(TASK, {"reward": {"information": 50.0}})
    plain, got = (
        run_courses(make_controller("fixed_slip", task), task, SEED, 4) for task in (TASK, paid)
    )
    np.testing.assert_array_equal(got.returns, plain.returns)


class Torques(Half):
    """Acts in another way than the scenario."""

    drives = {"action": "torque", "repeat": 1}
    attached = False

    def attach(self, *_):
        self.attached = True


def test_a_class_drives_as_it_says(monkeypatch):
    """A controller that is named module:Class has its `drives`, and is attached."""
    monkeypatch.setitem(globals(), "made_of_it", thing := Torques())
    (asked,) = parse(f"{__name__}:made_of_it").values()
    task = load_scenario("mixed", {"course": {"length": 1.0}})
    named = run_courses(load_contestant(asked, task), task, SEED, 3)
    assert thing.attached
    np.testing.assert_array_equal(named.energy, run_courses(thing, task, SEED, 3).energy)
    refused(lambda: run_courses(thing, task, SEED, 0), "courses = 0: expected at least one")
    thing.settings = {"mode": "gentle"}
    refused(lambda: load_contestant(asked, task), "settings = ", "expected a mapping of names to")
    del thing.settings
    for wrong in ({"acton": "torque"}, {"time_limit": 20.0}, "torque", {"repeat": 0}):
        thing.drives = wrong
        refused(
            lambda: load_contestant(asked, task), "repeat = 0" if "repeat" in wrong else "drives"
        )


def test_a_planner_of_a_module_is_attached_before_it_is_tried():
    task = load_scenario("mixed", {"course": {"length": 1.0}})
    (asked,) = parse("o=soil_env_agents.controllers.oracle:Oracle").values()
    check(asked, task)


def test_nan_for_a_course_that_has_ended_is_allowed():
    class Careless(Half):
        """Full command, but NaN for courses that have ended, if `careless`."""

        def __init__(self, careless):
            self.careless = careless

        def predict(self, obs, state=None, episode_start=None, deterministic=True):
            action = np.ones((len(obs), 1))
            # The readings of a wheel that drives are noisy: they never repeat.
            if state is not None:
                action[(obs == state).all(axis=1)] = np.nan if self.careless else 1.0
            return action, obs.copy()

    a, b = (run_courses(Careless(flag), TASK, SEED, 6) for flag in (True, False))
    assert a.columns() == b.columns()
