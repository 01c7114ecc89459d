"""Processes and threads: an environment is the same wherever it is stepped, and does not outlive
its close.
"""

import multiprocessing
import threading

import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv

from soil_env.envs.wheel_env import SoilWheelEnv, SoilWheelVectorEnv

SHORT = {"course": {"length": 2.0}}
ACTION = np.array([0.45], dtype=np.float32)
METHODS = [  # "forkserver" does what "spawn" does
    m if m == "fork" else pytest.param(m, marks=pytest.mark.slow)
    for m in multiprocessing.get_all_start_methods()
    if m != "forkserver"
]


def make_env():
    """A short single environment; a function of the module, so that processes can import it."""
    return SoilWheelEnv(**SHORT)


def _drive(queue, env):
    """Step the environment twice, in a process of its own, and send back the last observation."""
    env.step(np.full((64, 1), 0.4))
    queue.put(env.step(np.full((64, 1), 0.4))[0])


@pytest.mark.parametrize("method", METHODS)
def test_processes_step_as_this_one(method):
    """With the threads of a vector env alive in this process, which a fork does not take along."""
    env = SoilWheelVectorEnv(64, threads=3)
    same = SoilWheelVectorEnv(64, threads=3)
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
    many = AsyncVectorEnv([make_env] * 2, context=method)
    try:
        observations, _ = many.reset(seed=[4, 5])
        stepped = many.step(np.array([ACTION, ACTION]))[0]
    finally:
        many.close()
    for k in range(2):
        one = make_env()
        np.testing.assert_array_equal(observations[k], one.reset(seed=4 + k)[0])
        np.testing.assert_array_equal(stepped[k], one.step(ACTION)[0])


def test_two_vector_envs_in_two_threads_at_once():
    """Three of them, in as many threads: each drives as it does alone."""
    results = {}
    a = np.full((48, 1), 0.4)

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
