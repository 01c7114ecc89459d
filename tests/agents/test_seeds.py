"""Training seeds: each an agent of its own, that of train.py; what is missing is trained (engines: test_engines)."""

import numpy as np
import pytest

from agents import seeds, studies, training
from agents.agent import load_agent
from agents.config import TrainConfig
from soil_env.parameters import load_scenario

TINY = (
    "--ppo.num_envs=4 --ppo.n_steps=16 --ppo.batch_size=32 --ppo.n_epochs=1 --ppo.layer=4 --timesteps=128 "
    "--changes.control.time_limit=5 --changes.course.length=2"
).split()


@pytest.fixture(scope="module")
def local(tmp_path_factory):
    out = tmp_path_factory.mktemp("seeds") / "out"
    assert seeds.main(["--seeds=3", f"--out={out}", *TINY]) == 0
    return out


def weights(folder):
    agent = load_agent(folder)
    return [p.detach().numpy() for p in agent.policy.parameters()] + [agent.mean, agent.sd]


def same(a, b, count=3):
    assert sorted(p.name for p in b.iterdir()) == [f"seed_{k}" for k in range(count)]
    for k in range(count):
        for x, y in zip(weights(a / f"seed_{k}"), weights(b / f"seed_{k}"), strict=True):
            assert np.array_equal(x, y)


def test_each_seed_is_a_run_folder_of_its_own_agent(local):
    folders = sorted(local.iterdir())
    assert [f.name for f in folders] == ["seed_0", "seed_1", "seed_2"]
    for k, folder in enumerate(folders):
        assert {f.name for f in folder.iterdir()} >= {"config.yaml", "scenario.yaml", "model.zip", "tensorboard"}
        config, scenario = training.open_run(folder)
        assert (config.seed, config.name, config.runs) == (k, folder.name, str(local))
        assert scenario.control.time_limit == 5.0
    assert not np.array_equal(weights(folders[0])[0], weights(folders[1])[0])


def test_a_seed_gives_the_agent_of_train_py(local, tmp_path):
    config, scenario = training.open_run(local / "seed_1")
    (tmp_path / "run").mkdir()
    training.train(tmp_path / "run", config, scenario)
    for x, y in zip(weights(tmp_path / "run"), weights(local / "seed_1"), strict=True):
        assert np.array_equal(x, y)


def test_seeds_of_a_rover_are_rovers(tmp_path, capsys):
    assert seeds.main(["--seeds=1", f"--out={tmp_path}", "--rover=lunar_micro_rover", "--ppo.history=0", *TINY]) == 0
    assert load_agent(tmp_path / "seed_0").policy.action_space.shape == (2,)
    assert f"train --resume {tmp_path / 'seed_0'}" in capsys.readouterr().out.replace("\n", "")


def test_the_same_command_trains_what_is_missing(local, tmp_path, monkeypatch, capsys):
    trained = []

    def interrupted(work, tasks):
        for task, result in studies.in_process(work, tasks):
            trained.append(task)
            yield task, result
            raise KeyboardInterrupt

    command = ["--seeds=3", f"--out={tmp_path}/out", *TINY]
    with monkeypatch.context() as patch:
        patch.setattr(studies, "choose", lambda *a: interrupted)
        assert seeds.main(command) == 130 and trained == [0]
    assert seeds.main(command) == 0
    same(local, tmp_path / "out")
    capsys.readouterr()
    assert seeds.main([*command, "--ppo.gamma=0.9"]) == 2
    assert "seed_0: was trained with another config" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--seed=1"], "--seed: is set for every seed"),
        (["--seeds=0"], "at least one seed"),
        (["--gama=1"], "gama"),
        (["--engine=rey"], "did you mean 'ray'"),
        (["--address=x"], "only with --engine ray"),
    ],
)
def test_bad_input_is_one_line(given, said, tmp_path, capsys):
    assert seeds.main([f"--out={tmp_path}/out", *given]) == 2
    error = capsys.readouterr().err
    assert error.startswith("agents.seeds: ") and error.count("\n") == 1 and said in error
    assert not (tmp_path / "out").exists()


def test_other_code_on_a_worker_is_refused(tmp_path):
    with pytest.raises(seeds.ParameterError, match="a worker has soil_env"):
        seeds.Training(TrainConfig(), load_scenario(), "0.0.0+other")(0)
