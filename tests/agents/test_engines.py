"""Every engine gives the same evaluation, and a worker that is killed loses nothing."""

import json
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from agents import ppo, studies
from agents.evaluate.__main__ import main
from soil_env._io.loading import ParameterError
from soil_env.parameters import load_scenario
from tests.agents import work

ROOT = Path(__file__).resolve().parents[2]
SHORT = "--changes.control.time_limit=6 --changes.course.length=2 --courses=8 --block=2 --resamples=50 --seed=3".split()
RESULTS = ("evaluation.json", "evaluation.csv", "courses.csv", "report.html", "metrics.png")


@pytest.fixture(scope="module")
def controllers(tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "model.zip"
    model = ppo.build(load_scenario(), "identified", ppo.PPOConfig(4, 8, 32, 1, layer=4), 0)
    model.learn(64)
    ppo.save(model, path)
    return f"--controllers=fixed_slip,tests.agents.drivers:Counting,ppo={path}"


@pytest.fixture(scope="module")
def local(controllers, tmp_path_factory):
    out = tmp_path_factory.mktemp("local") / "out"
    assert main([*SHORT, controllers, f"--out={out}"]) == 0
    return out


def same(a, b):
    for name in RESULTS:
        assert (a / name).read_bytes() == (b / name).read_bytes(), name
    logs = [[json.loads(line) for line in (f / "courses.jsonl").read_text().splitlines()] for f in (a, b)]
    key = [sorted((e["controller"], e["first"]) for e in log) for log in logs]
    assert key[0] == key[1] and len(set(key[0])) == len(key[0])  # every block once
    assert sorted(logs[0], key=str) == sorted(logs[1], key=str)


# --- processes --------------------------------------------------------------------------------------------------------


def test_processes_give_what_one_process_gives(controllers, local, tmp_path, importable):
    assert main([*SHORT, controllers, f"--out={tmp_path}/out", "--workers=2"]) == 0
    same(tmp_path / "out", local)


@pytest.fixture(params=["processes", "ray"])
def engine(request):
    """A function that does work elsewhere."""
    request.getfixturevalue("importable" if request.param == "processes" else "connected")
    return partial(studies.processes, workers=2) if request.param == "processes" else studies.on_ray


def test_a_killed_worker_loses_nothing(tmp_path, engine):
    tasks = [(k, str(tmp_path / "mark") if k == 3 else "") for k in range(8)]
    done = list(engine(work.double, tasks))
    assert sorted(done) == [(task, 2 * task[0]) for task in tasks]
    assert (tmp_path / "mark").exists()


def test_processes_that_always_die_are_given_up(importable):
    with pytest.raises(ParameterError, match="died 4 times"):
        list(studies.processes(work.always_die, [(0, "")], workers=1))


def test_work_under_way_is_interrupted_when_the_study_is(importable, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = studies.processes(work.waiting, ["long", "short"], workers=2)
    assert next(done) == ("short", None)
    done.close()
    assert (tmp_path / "interrupted").exists()


def test_bad_input_found_by_a_worker_comes_back(engine):
    with pytest.raises(ParameterError, match="^no 5$"):
        list(engine(work.refuse, [(5, "")]))


def test_ray_that_is_absent_is_said_in_one_line(capsys, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "ray", None)
    assert main([*SHORT, "--controllers=full_throttle", f"--out={tmp_path}/out", "--engine=ray"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "pip install 'soil_env[ray]'" in error
    assert not (tmp_path / "out").exists()


# --- Ray --------------------------------------------------------------------------------------------------------------


def test_ray_uses_both_nodes(connected):
    nodes = {node for _, node in studies.on_ray(work.where, range(8))}
    assert len(nodes) == 2


def test_ray_gives_what_one_process_gives(cluster, controllers, local, tmp_path):
    """As a user calls it; the models travel with the tasks."""
    out = tmp_path / "out"
    command = [sys.executable, "-m", "agents.evaluate", *SHORT, controllers, f"--out={out}", "--engine=ray"]
    done = subprocess.run(
        [*command, f"--address={cluster.address}"], cwd=ROOT, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr[-2000:]
    same(out, local)


def test_an_evaluation_survives_the_loss_of_a_node(cluster, controllers, local, tmp_path):
    """The node is taken away after the first results, and the evaluation still has every block once."""
    import ray

    from agents.evaluate import study as evaluation

    node = cluster.add_node(num_cpus=2)
    cluster.wait_for_nodes()
    ray.init(address=cluster.address, log_to_driver=False, logging_level="ERROR")
    try:
        out = tmp_path / "out"
        out.mkdir()
        study = evaluation.load_study(local)
        studies.save_study(study, out)
        taken = []

        def engine(job, tasks):
            for result in studies.on_ray(job, tasks):
                if not taken:
                    taken.append(cluster.remove_node(node, allow_graceful=False))
                yield result

        evaluation.run(study, out, engine, evaluation.Job(study, 1, ship=True), lambda count: None)
    finally:
        ray.shutdown()
    assert taken
    assert main(["--resume", str(out)]) == 0
    same(out, local)


@pytest.mark.parametrize("address", ["127.0.0.1:9", "nonsense"])
def test_a_cluster_that_is_not_there_is_said_in_one_line(capsys, tmp_path, address):
    pytest.importorskip("ray")
    command = [*SHORT, "--controllers=full_throttle", f"--out={tmp_path}/out", "--engine=ray", f"--address={address}"]
    assert main(command) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and f"no cluster at {address}" in error
    assert not (tmp_path / "out").exists()
