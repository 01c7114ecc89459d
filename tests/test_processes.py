"""Processes and threads: an environment is the same wherever it is stepped, and does not outlive its close."""

import multiprocessing
import os
import subprocess
import sys
import threading

import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv

from soil_env.env import SoilWheelEnv
from soil_env.vector_env import SoilWheelVectorEnv

SHORT = {"course": {"length": 2.0}}
ACTION = np.array([0.45], dtype=np.float32)
METHODS = [
    m if m == "fork" else pytest.param(m, marks=pytest.mark.slow) for m in multiprocessing.get_all_start_methods()
]


def make_env():
    return SoilWheelEnv(**SHORT)


@pytest.mark.parametrize("method", METHODS)
def test_processes_step_as_this_one(method):
    """With the threads of a vector env alive in this process, which a fork does not take along."""
    SoilWheelVectorEnv(64, threads=3).reset(seed=0)
    many = AsyncVectorEnv([make_env] * 2, context=method)
    try:
        observations, _ = many.reset(seed=[4, 5])
        stepped = many.step(np.array([ACTION, ACTION]))[0]
    finally:
        many.close()
    for k in range(2):
        env = make_env()
        np.testing.assert_array_equal(observations[k], env.reset(seed=4 + k)[0])
        np.testing.assert_array_equal(stepped[k], env.step(ACTION)[0])


def _drive(queue, env):
    env.step(np.full((64, 1), 0.4))
    queue.put(env.step(np.full((64, 1), 0.4))[0])


@pytest.mark.parametrize("method", METHODS)
def test_a_vector_env_with_threads_in_another_process(method):
    env, same = SoilWheelVectorEnv(64, threads=3), SoilWheelVectorEnv(64, threads=3)
    for e in (env, same):
        e.reset(seed=1)
    context = multiprocessing.get_context(method)
    queue = context.SimpleQueue()
    child = context.Process(target=_drive, args=(queue, env))
    child.start()
    there = queue.get()
    child.join()
    same.step(np.full((64, 1), 0.4))
    np.testing.assert_array_equal(there, same.step(np.full((64, 1), 0.4))[0])


def test_two_vector_envs_in_two_threads_at_once():
    results, a = {}, np.full((48, 1), 0.4)

    def drive(name, seed):
        env = SoilWheelVectorEnv(48, threads=2, **SHORT)
        env.reset(seed=seed)
        results[name] = [env.step(a)[0] for _ in range(60)]

    workers = [threading.Thread(target=drive, args=(k, k)) for k in range(3)]
    for w in workers:
        w.start()
    for w in workers:
        w.join()
    for k in range(3):
        drive("alone", k)
        np.testing.assert_array_equal(results["alone"], results[k])


def test_close_twice_and_use_after_it():
    """There is nothing to release but the window, so that a closed environment goes on; it opens a new picture."""
    env = SoilWheelEnv(render_mode="rgb_array", **SHORT)
    env.close()
    first, _ = env.reset(seed=2)
    env.render()
    env.close()
    env.close()
    np.testing.assert_array_equal(env.step(ACTION)[0], rollout_from(2))
    assert env.render().shape == (540, 960, 3)
    env.close()
    many = SoilWheelVectorEnv(2, **SHORT)
    many.reset(seed=2)
    many.close()
    many.close()
    np.testing.assert_array_equal(many.step(np.array([ACTION, ACTION]))[0][0], rollout_from(2))


def rollout_from(seed):
    env = make_env()
    env.reset(seed=seed)
    return env.step(ACTION)[0]


CODE = """
import numpy as np
from soil_env.vector_env import SoilWheelVectorEnv
env = SoilWheelVectorEnv(40, course={"length": 2.0})
env.reset(seed=3)
for _ in range(5):
    out = env.step(np.full((40, 1), 0.45))
print(out[0].tobytes().hex()[:64])
"""


def poor(folder, **changes):
    """Output of CODE in a process that has one processor, no home and no cache it could write."""
    nowhere = "/proc/nowhere"
    env = {**os.environ, "HOME": nowhere, "NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", **changes}
    before = (lambda: os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})) if sys.platform == "linux" else None
    done = subprocess.run(
        [sys.executable, "-c", CODE], cwd=folder, env=env, capture_output=True, text=True, preexec_fn=before
    )
    assert done.returncode == 0, done.stderr[-800:]
    return done.stdout, done.stderr


def test_one_processor_and_no_home(tmp_path):
    root = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    text, error = poor(tmp_path, PYTHONPATH=root)
    env = SoilWheelVectorEnv(40, **SHORT)
    env.reset(seed=3)
    for _ in range(5):
        out = env.step(np.full((40, 1), 0.45))
    assert text.strip() == out[0].tobytes().hex()[:64] and error == ""
