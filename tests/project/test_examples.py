"""The examples run, say what they promise and draw their picture; those whose client is missing are left out."""

import re
import runpy
import sys
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

FOLDER = Path(__file__).resolve().parents[2] / "examples"
pytestmark = pytest.mark.documents
RUNS = {  # script -> (arguments, picture, what it has to print, module it needs)
    "drive": ("--frame 40 --out wheel.png", "wheel.png", r"best_slip_identified: RUNNING at 0\.\d+ m", "gymnasium"),
    "drive_rover": (
        "--rover mars_rover --frame 30 --out rover.png",
        "rover.png",
        r"mars_rover: RUNNING at 0\.\d+ m.*\n  front: slip .*\n  middle: .*\n  rear: .* friction angle \d",
        "pygame",
    ),
    "identify_soil": ("", "identified.png", r"friction_angle_deg +31\.4\d", "scipy"),
    "record_bag": ("--steps 200", "", r"200 sets of readings.*\n.*drive: \d\.\de-0[5-9]", "rosbags"),
    "live_identifier": ("--steps 120", "", r"\d+ sets of readings; Soil\(", "gymnasium"),
    "find_missing_effect": ("", "gap.png", r"verdict: named\n  slip_sinkage: ", "scipy"),
    "compare_controllers": (
        "--courses 4 --tuning-courses 2",
        "compared.png",
        r"best_slip_true +immobilised +[\d.]+%",
        "gymnasium",
    ),
    "own_controller": ("", "own_controller.png", "written", "gymnasium"),
    "own_soil": ("--steps 40", "own_soil.png", r"RUNNING at 0\.\d+ m", "pygame"),
    "vector_env": (
        "--wheels 16 --steps 200",
        "vector_env.png",
        r"second; courses that ended: \{'",
        "gymnasium",
    ),
    "model_with_effect": ("--courses 4", "bulldozing.png", r"with bulldozing +immobilised", "gymnasium"),
    "train_ppo": ("--steps 16384 --courses 4", "training.png", r"full throttle +return", "stable_baselines3"),
    "cleanrl_ppo": ("--steps 4096 --length 16 --courses 4", "cleanrl_ppo.png", r"same 4 courses: ppo -?\d", "torch"),
    "rllib_ppo": ("--iterations 1 --batch 512 --wheels 16", "", r"1: \d+ steps", "ray.rllib"),
    "minari_dataset": ("--episodes 1", "", "replayed: 0 steps differ", "minari"),
}


def run(name, arguments, folder, monkeypatch):
    """Run a script as the command line does, in an empty folder."""
    monkeypatch.chdir(folder)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(folder))
    monkeypatch.setattr(sys, "argv", [f"{name}.py", *arguments.split()])
    return runpy.run_path(str(FOLDER / f"{name}.py"), run_name="__main__")


@pytest.mark.parametrize("name", RUNS)
def test_example_runs(name, tmp_path, monkeypatch, capsys):
    arguments, picture, said, needs = RUNS[name]
    pytest.importorskip(needs)
    run(name, arguments, tmp_path, monkeypatch)
    assert re.search(said, capsys.readouterr().out)
    if picture:
        pixels = matplotlib.image.imread(tmp_path / picture)
        assert min(pixels.shape[:2]) > 200 and np.std(pixels[..., :3]) > 0.02  # something is drawn


@pytest.mark.parametrize(
    "name, module, extra",
    [("train_ppo", "stable_baselines3", "train"), ("cleanrl_ppo", "torch", "train"), ("rllib_ppo", "ray", "rllib"),
     ("minari_dataset", "minari", "minari"), ("record_bag", "rosbags", "logs")],
)  # fmt: skip
def test_an_example_without_its_extra_says_what_to_install(name, module, extra, tmp_path, monkeypatch, capsys):
    for known in {module, *(m for m in sys.modules if m.startswith(f"{module}."))}:
        monkeypatch.setitem(sys.modules, known, None)
    with pytest.raises(SystemExit) as end:
        run(name, "", tmp_path, monkeypatch)
    said = capsys.readouterr().err
    assert end.value.code == 2 and said.count("\n") == 1
    assert said.startswith(f"{name}.py: needs ") and said.endswith(f": pip install 'soil_env[{extra}]'\n")


@pytest.mark.parametrize(
    "name, arguments",
    [("drive", "--scenario nowhere.yaml"), ("drive", "--seed -1"), ("own_soil", "--phi 95"),
     ("find_missing_effect", "nowhere.csv"), ("identify_soil", "nowhere.csv")],
)  # fmt: skip
def test_bad_input_is_said_in_one_line(name, arguments, tmp_path, monkeypatch, capsys):
    with pytest.raises(SystemExit) as end:
        run(name, arguments, tmp_path, monkeypatch)
    said = capsys.readouterr().err
    assert end.value.code == 2 and said.startswith(f"{name}.py: error: ") and said.count("\n") == 1


@pytest.mark.parametrize("port", ["0", "-1", "65536", "99999"])
def test_a_port_that_cannot_be_is_refused(port, tmp_path, monkeypatch, capsys):
    with pytest.raises(SystemExit) as end:
        run("live_identifier", f"--udp {port}", tmp_path, monkeypatch)
    said = capsys.readouterr().err
    assert end.value.code == 2 and f"--udp {port}: expected a port, from 1 to 65535" in said


def test_a_frame_after_the_end_of_the_course_is_told(tmp_path, monkeypatch, capsys):
    run("drive", "--controller full_throttle --frame 100000 --out wheel.png", tmp_path, monkeypatch)
    said = capsys.readouterr().out
    told = r"^--frame 100000: the course ended before, after \d+ periods; the picture is of its end$"
    assert re.search(told, said, re.MULTILINE)


def test_a_rover_that_identifies_nothing_is_driven(tmp_path, monkeypatch, capsys):
    (tmp_path / "mine.yaml").write_text((FOLDER.parent / "configs/rovers/field_rover.yaml").read_text().replace(
        "\nbelief: {", "\nbelief: {method: none, "))  # fmt: skip
    run("drive_rover", "--rover mine.yaml --frame 3 --out rover.png", tmp_path, monkeypatch)
    assert re.search(r"RUNNING.*\n  front: .*; friction angle not identified\n  rear:", capsys.readouterr().out)


def test_every_example_is_run():
    assert {p.stem for p in FOLDER.glob("*.py")} == set(RUNS)


# --- the single-file PPO ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def cleanrl():
    pytest.importorskip("torch")
    return runpy.run_path(str(FOLDER / "cleanrl_ppo.py"))


def test_advantages_are_those_of_the_sum(cleanrl):
    """Schulman et al. (2016), Eq. 16, summed term by term; a course that ended hands nothing on."""
    import torch

    rng = np.random.default_rng(0)
    rewards, values = rng.normal(size=(2, 6, 3))
    dones, last = (rng.random((6, 3)) < 0.3).astype(float), rng.normal(size=3)
    found = cleanrl["advantages"](*(torch.tensor(x) for x in (rewards, values, dones, last))).numpy()
    gamma, lam = cleanrl["GAMMA"], cleanrl["LAMBDA"]
    following = np.vstack([values[1:], last])
    for k in range(3):
        for t in range(6):
            total, factor = 0.0, 1.0
            for s in range(t, 6):
                total += factor * (rewards[s, k] + gamma * following[s, k] * (1 - dones[s, k]) - values[s, k])
                if dones[s, k]:
                    break
                factor *= gamma * lam
            assert found[t, k] == pytest.approx(total)


def test_only_truncated_courses_are_bootstrapped(cleanrl):
    """On the real environment: with the value of the last observation, not of the first one of the next course."""
    import gymnasium

    envs = gymnasium.make_vec(
        "soil_env:SoilWheel-v0", num_envs=3, vectorization_mode="vector_entry_point", max_episode_steps=5,
        autoreset_mode=gymnasium.vector.AutoresetMode.SAME_STEP, observation="blind",
    )  # fmt: skip
    envs.reset(seed=0)
    for _ in range(5):
        observation, reward, _, truncated, info = envs.step(np.full((3, 1), 0.5, np.float32))
    assert truncated.all() and not np.array_equal(np.stack(info["final_obs"]), observation)
    some = np.array([True, False, True])
    seen = []
    found = cleanrl["bootstrapped"](reward, some, info, lambda last: seen.append(last) or last[:, 4])
    assert np.array_equal(seen[0], np.stack(info["final_obs"])[some])
    expected = reward + cleanrl["GAMMA"] * np.where(some, np.stack(info["final_obs"])[:, 4], 0.0)
    assert found == pytest.approx(expected) and found is not reward
