"""python -m agents.ablation: what it keeps, that it goes on where it was, and its verdicts on made-up numbers."""

import dataclasses
import json
import shutil
import signal
import subprocess
import sys
import time
import types

import numpy as np
import pytest
import yaml

from agents.ablation import __main__ as ablation, page, results, study
from agents.ablation.__main__ import main
from agents.controllers import CONTROLLERS
from agents.evaluate import HELD_OUT_SET, run_courses
from agents.evaluate.models import load_model
from soil_env._io.loading import config_dir
from soil_env.terramechanics.model import WheelSoilModel

SHORT = {"course": {"length": 2.0}, "control": {"time_limit": 6.0}}
PPO = {"num_envs": 4, "n_steps": 16, "batch_size": 32, "n_epochs": 1, "layer": 4, "threads": 1}
CONFIG = {
    "scenarios": {
        "mixed": {"changes": SHORT},
        "elsewhere": {"scenario": "unseen", "trained_on": "mixed", "changes": SHORT, "model": "effect.yaml"},
    },
    "agents": {
        "ppo_identified": {
            "observation": "identified", "hidden_worlds": 1, "timesteps": 192, "ppo": PPO | {"history": 2},
        },
        "ppo_true": {"observation": "true_soil", "timesteps": 192, "ppo": PPO},
    },
    "seeds": 2, "courses": 6, "tuning_courses": 1, "block": 4, "resamples": 50, "checkpoint_every": 64,
}  # fmt: skip


def config(folder, **changes):
    """A small study as a file in `folder`."""
    shutil.copy(config_dir() / "worlds" / "bulldozing.yaml", folder / "effect.yaml")
    path = folder / "ablation.yaml"
    path.write_text(yaml.safe_dump({**CONFIG, **changes}, sort_keys=False))
    return path


def refused(capsys, *arguments):
    """stderr of a command that has to be refused: one line, status 2."""
    capsys.readouterr()
    assert main(list(map(str, arguments))) == 2
    err = capsys.readouterr().err
    assert err.startswith("agents.ablation: ") and err.count("\n") == 1, err
    return err


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A finished study."""
    folder = tmp_path_factory.mktemp("ablation")
    assert main(["--config", str(config(folder)), "--out", str(folder / "out")]) == 0
    return folder / "out"


def read(folder):
    return json.loads((folder / "comparison.json").read_text())


# --- what it keeps ----------------------------------------------------------------------------------------------------


def test_every_controller_is_compared_everywhere(done):
    result = read(done)
    assert list(result["scenarios"]) == ["mixed", "elsewhere"]
    for name, entry in result["scenarios"].items():
        assert list(entry["controllers"]) == [*CONTROLLERS, "ppo_identified", "ppo_true"]
        assert entry["trained_on"] == "mixed" and ("model" in entry) == (name == "elsewhere")
        for key, c in entry["controllers"].items():
            assert c["members"] == len(c["by_seed"]["immobilised"]) == (2 if key.startswith("ppo") else 1)
    assert (
        result["scenarios"]["mixed"]["controllers"]["fixed_slip"]["settings"].keys()
        == CONTROLLERS["fixed_slip"].bounds.keys()
    )


def test_agents_are_judged_as_they_drive(done):
    """The numbers are those of the saved models on the held-out courses, in the world of the target."""
    asked, result = study.open_study(done), read(done)
    for name, target in asked.targets.items():
        for seed in (0, 1):
            model = load_model(done / "mixed" / "trained" / f"ppo_identified-{seed}" / "model.zip", target.scenario)
            runs = run_courses(model, target.scenario, HELD_OUT_SET, 6, batch=4, model=target.world)
            by_seed = result["scenarios"][name]["controllers"]["ppo_identified"]["by_seed"]
            assert by_seed["return"][seed] == pytest.approx(runs.returns.mean(), rel=1e-9)
            assert by_seed["immobilised"][seed] == pytest.approx(runs.metric("immobilised").mean())
    assert (
        asked.targets["elsewhere"].world.effects == WheelSoilModel.load(config_dir() / "worlds/bulldozing.yaml").effects
    )


def test_seeds_differ_and_are_far_apart(done):
    configs = [
        yaml.safe_load((done / "mixed" / "trained" / f"ppo_true-{k}" / "config.yaml").read_text()) for k in (0, 1)
    ]
    assert abs(configs[0]["seed"] - configs[1]["seed"]) > 65536  # wheel k of a training has seed + k
    by_seed = read(done)["scenarios"]["mixed"]["controllers"]["ppo_true"]["by_seed"]["return"]
    assert by_seed[0] != by_seed[1]


def test_the_page_holds_what_the_result_says(done, tmp_path):
    (tmp_path / "comparison.md").write_text("# Title\n\nBefore.\n\n<!-- ablation -->\nold\n<!-- end -->\n\nAfter.\n")
    assert main(["--report", str(done), "--page", str(tmp_path / "comparison.md")]) == 0
    text = (tmp_path / "comparison.md").read_text()
    assert text.startswith("# Title\n\nBefore.") and text.endswith("\n\nAfter.\n") and "old" not in text
    result = json.loads((tmp_path / "comparison" / "comparison.json").read_text())
    m = result["scenarios"]["elsewhere"]["controllers"]["fixed_slip"]["metrics"]["immobilised"]
    cell = f"{100 * m['value']:.1f} [{100 * m['low']:.1f}, {100 * m['high']:.1f}]"
    section = text.split("## elsewhere")[1].split("\n## ")[0]
    assert any(line.startswith("| `fixed_slip`") and cell in line for line in section.splitlines())
    for name in ("overview.png", "profiles.png"):
        assert (tmp_path / "comparison" / name).read_bytes()[:4] == b"\x89PNG" and f"comparison/{name}" in text


# --- going on ---------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("unrendered")
def test_what_is_lost_is_made_again_and_gives_the_same(done, tmp_path):
    again = tmp_path / "out"
    shutil.copytree(done, again)
    (again / "mixed" / "driven" / "ppo_true-1.json").unlink()
    (again / "elsewhere" / "driven" / "full_throttle-0.json").unlink()
    shutil.rmtree(again / "mixed" / "trained" / "ppo_identified-0")
    for name in ("mixed", "elsewhere"):
        (again / name / "driven" / "ppo_identified-0.json").unlink()
    kept = (again / "mixed" / "trained" / "ppo_true-0" / "model.zip").stat().st_mtime_ns
    assert main(["--resume", str(again), "--workers", "1"]) == 0  # another process
    assert (again / "mixed" / "trained" / "ppo_true-0" / "model.zip").stat().st_mtime_ns == kept
    assert (again / "comparison.json").read_bytes() == (done / "comparison.json").read_bytes()


@pytest.mark.usefixtures("unrendered")
def test_a_study_grows_by_seeds_and_by_nothing_else(done, tmp_path, capsys):
    again = tmp_path / "out"
    shutil.copytree(done, again)
    path = config(tmp_path)
    assert "tuning_courses" in refused(capsys, "--config", config(tmp_path, tuning_courses=2), "--out", again)
    assert "agents" in refused(capsys, "--config", config(tmp_path), "--out", again, "--steps", "100")
    assert main(["--config", str(config(tmp_path)), "--out", str(again), "--seeds", "3"]) == 0
    entry = read(again)["scenarios"]["mixed"]["controllers"]["ppo_true"]
    assert entry["members"] == 3
    assert (
        entry["by_seed"]["return"][:2]
        == read(done)["scenarios"]["mixed"]["controllers"]["ppo_true"]["by_seed"]["return"]
    )
    assert path.is_file()


def test_a_killed_study_goes_on_from_its_checkpoints(tmp_path):
    """kill -9 of everything in the middle of a training."""
    agents = {"ppo_true": {**CONFIG["agents"]["ppo_true"], "timesteps": 100_000_000}}
    path, out = config(tmp_path, agents=agents, seeds=1), tmp_path / "out"
    command = [sys.executable, "-m", "agents.ablation", "--config", str(path), "--out", str(out), "--workers", "1"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, start_new_session=True)
    checkpoint = out / "mixed" / "trained" / "ppo_true-0" / "checkpoint.zip"
    try:
        for _ in range(3000):
            if checkpoint.is_file() or process.poll() is not None:
                break
            time.sleep(0.1)
        assert checkpoint.is_file()
    finally:
        import os

        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    from agents.agent import read_info

    steps = read_info(checkpoint).timesteps
    shorter = {"ppo_true": {**agents["ppo_true"], "timesteps": steps + 64}}
    begun = yaml.safe_load((out / "study.yaml").read_text())
    begun["agents"]["ppo_true"]["timesteps"] = steps + 64
    (out / "study.yaml").write_text(yaml.safe_dump(begun, sort_keys=False))
    run = out / "mixed" / "trained" / "ppo_true-0"
    asked = study.read_config(config(tmp_path, agents=shorter, seeds=1))
    told = []
    study.perform(asked, out, study.Step("mixed", "ppo_true", 0), told.append)
    assert read_info(run / "model.zip").timesteps == steps + 64
    assert sum(told) == steps + 64  # what the checkpoint had counts as done


# --- bad input --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "changes, said",
    [
        ({"scenarios": {"mixd": {}}}, "ablation.yaml: scenarios.mixd: scenario: unknown value"),
        ({"scenarios": {"mixed": {}, "unseen": {"trained_on": "stiky"}}}, "stiky"),
        ({"agents": {}}, "agent"),
        ({"agents": {"a-b": {"observation": "blind"}}}, "a-b"),
        ({"agents": {"fixed_slip": {"observation": "blind"}}}, "fixed_slip"),
        ({"agents": {"a": {"observation": "blind", "ppo": {"critic": "soil"}}}}, "critic = 'soil'"),
        ({"agents": {"a": {"observation": "blind", "hidden_worlds": -1}}}, "hidden_worlds"),
        ({"question": {"blind": "ppo_true"}}, "ppo_true reads true_soil"),
        ({"question": {"blind": "nobody"}}, "nobody"),
        (
            {"scenarios": {"mixed": {}, "unseen": {"trained_on": "mixd"}}},
            "ablation.yaml: scenarios.unseen: trained_on: ",
        ),
        ({"scenarios": {"mixed": {}, "unseen": {"trained_on": 5}}}, "ablation.yaml: scenarios.unseen.trained_on = 5"),
        ({"seed": 1}, "question, resamples, scenarios, seeds, tuning_courses)"),
        ({"targets": {}}, "ablation.yaml: unknown key 'targets'"),
        ({"version": "1"}, "ablation.yaml: unknown key 'version'"),
        ({"scenarios": {"mixed": ["sticky"]}}, "ablation.yaml: scenarios.mixed = ['sticky']: expected a mapping"),
        ({"scenarios": {"mixed": {"changes": 5}}}, "ablation.yaml: scenarios.mixed.changes = 5: expected a mapping"),
        ({"scenarios": {"mixed": {"model": 5}}}, "ablation.yaml: scenarios.mixed.model = 5: expected the path"),
        ({"scenarios": {"mixed": {"changes": {"course": {"lenght": 1}}}}}, "ablation.yaml: scenarios.mixed.changes"),
    ],
)
def test_a_bad_config_is_refused_in_one_line(tmp_path, capsys, changes, said):
    out = tmp_path / "out"
    assert said in refused(capsys, "--config", config(tmp_path, **changes), "--out", out)
    assert not out.exists()


def test_bad_options_are_refused_in_one_line(done, tmp_path, capsys):
    path = config(tmp_path)
    assert "--seeds" in refused(capsys, "--resume", done, "--seeds", "3")
    assert "stiky" in refused(capsys, "--config", path, "--out", tmp_path / "o", "--scenarios", "stiky")
    assert "study" in refused(capsys, "--config", path, "--out", tmp_path)  # not empty, and no study
    with pytest.raises(SystemExit) as stopped:
        main(["--config", str(path), "--steps", "abc"])
    assert stopped.value.code == 2 and "--steps: 'abc': expected a whole number >= 1" in capsys.readouterr().err


def test_a_page_that_cannot_be_written_is_refused_before_the_study(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(ablation, "fill", lambda *_: pytest.fail("the study was begun"))
    path, out, marked, plain = config(tmp_path), tmp_path / "o", tmp_path / "marked.md", tmp_path / "plain.md"
    plain.write_text("# Title\n")
    marked.write_text(page.EMPTY_PAGE)
    (tmp_path / "marked").write_text("no folder for the figures")
    for given, words in (
        (tmp_path / "nosuch" / "x.md", f"{tmp_path / 'nosuch'}: no such folder"),
        (plain, "plain.md: expected one pair of markers"),
        (marked, f"{tmp_path / 'marked'}: is a file"),
        (tmp_path / "name", f"--page {tmp_path / 'name'}: expected a file NAME.md"),
    ):
        assert words in refused(capsys, "--config", path, "--out", out, "--page", given)
        assert not out.exists()
    page.check(tmp_path / "new.md")  # is made
    assert not (tmp_path / "new.md").exists()


def test_an_empty_config_is_refused(tmp_path, capsys):
    path = tmp_path / "empty.yaml"
    path.write_text("")
    assert "empty.yaml: is empty: expected keys" in refused(capsys, "--config", path, "--out", tmp_path / "o")


def test_the_shipped_configs_can_be_read():
    for name, expected in {
        "ablation.yaml": ["blind_memory", "identified_memory", "true_soil"],
        "ablation_harder.yaml": ["blind_memory", "robust", None],
        "ablation_wider.yaml": ["robust_blind", "robust", None],
        "ablation_narrow.yaml": ["robust_blind", "robust", None],
        "ablation_smoke.yaml": ["ppo_blind", "ppo_identified", "ppo_true"],
    }.items():
        asked = study.read_config(config_dir() / name)
        assert [asked.asked_about(variant) for variant in ("blind", "identified", "true_soil")] == expected
    wider, narrow = (study.read_config(config_dir() / f"ablation_{name}.yaml") for name in ("wider", "narrow"))
    assert narrow.held_out == wider.held_out and narrow.targets["unseen"].model == wider.targets["unseen"].model
    assert all(wider.agents[name] == spec for name, spec in narrow.agents.items())  # a control
    asked = study.read_config(config_dir() / "ablation.yaml")
    assert asked.seeds >= 3 and asked.courses >= 1000
    assert asked.targets["unseen"].world is not None and asked.source("unseen") == "mixed"
    soils = [set(asked.targets[name].scenario.soils) for name in ("mixed", "unseen")]
    assert not soils[0] & soils[1]


# --- verdicts ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def asked():
    return study.read_config(config_dir() / "ablation.yaml")


def entry(**rates):
    """Finished courses in percent: name = (value, low, high)."""
    keys = ("value", "low", "high")
    return {
        "controllers": {
            name: {"metrics": {"finished": dict(zip(keys, np.array(r) / 100.0, strict=True))}}
            for name, r in rates.items()
        }
    }


@pytest.mark.parametrize(
    "blind, answer, kind",
    [
        ((88, 86, 90), "yes", "apart"),
        ((91, 89, 93), "open", "more"),
        ((93, 91, 95), "no", "not more"),
        ((97, 96, 98), "no", "fewer"),
    ],
)
def test_beats_needs_intervals_apart_from_all_that_do_not_know_the_truth(asked, blind, answer, kind):
    found = entry(identified=(93, 92, 94), blind=blind, fixed_slip=(80, 78, 82), true_soil=(98, 97, 99),
                  best_slip_true=(99, 98, 100))  # fmt: skip
    verdict = results._beats(asked, found, "identified")
    assert verdict == {"answer": answer, "details": {"blind": kind, "fixed_slip": "apart"}}


@pytest.mark.parametrize(
    "identified, true, answer",
    [(0.79, 0.80, "yes"), (0.62, 0.80, "no"), (0.74, 0.80, "open"), (0.602, 0.602, "open"), (0.6, 0.6, "open")],
)
def test_the_share_of_what_the_soil_is_worth(asked, identified, true, answer):
    """Of 60 % that the blind agent finishes; two seeds of 500 courses each, where courses are alike for all."""
    courses, names = 500, {"blind": 0.6, "identified": identified, "true_soil": true}
    agents = {name: study.AgentSpec(observation=name) for name in names}
    own = dataclasses.replace(asked, agents=agents, question=study.Question())

    class Scored:
        def __init__(self, rate):
            self.finished = (np.arange(courses) < rate * courses).astype(float)

        def metric(self, name):
            return self.finished

    records = {name: [Scored(rate), Scored(rate)] for name, rate in names.items()}
    worth = results._worth(own, types.SimpleNamespace(seed=1, courses=courses, resamples=500), records)
    assert worth["soil"]["value"] == pytest.approx(true - 0.6)
    assert worth["identifier"]["low"] <= identified - 0.6 <= worth["identifier"]["high"]
    if true > 0.6:
        assert worth["share"]["value"] == pytest.approx((identified - 0.6) / (true - 0.6))
    assert results._covers(worth)["answer"] == answer


def test_loses_least_is_asked_of_all_that_do_not_know_the_truth(asked):
    def losses(**against):
        keys = ("value", "low", "high")
        out = {n: {"against": dict(zip(keys, a, strict=True))} for n, a in against.items()}
        return {"finished": {"identified": {}, **out}}

    less, unclear, more = (-0.1, -0.15, -0.05), (-0.02, -0.05, 0.01), (0.01, -0.02, 0.04)
    judge = results._loses_least
    assert judge(asked, losses(blind=less, true_soil=more), "identified")["answer"] == "yes"
    assert judge(asked, losses(blind=less, fixed_slip=unclear), "identified")["answer"] == "open"
    assert judge(asked, losses(blind=less, fixed_slip=more), "identified")["answer"] == "no"


def test_a_loss_is_the_difference_of_the_means(done):
    asked, result = study.open_study(done), read(done)
    for metric, sign in (("immobilised", 1), ("finished", -1)):
        for name, loss in result["loss"]["elsewhere"][metric].items():
            rates = [result["scenarios"][s]["controllers"][name]["metrics"][metric]["value"] for s in asked.targets]
            assert loss["value"] == pytest.approx(sign * (rates[1] - rates[0]), abs=1e-12)
            assert loss["low"] <= loss["value"] <= loss["high"]
