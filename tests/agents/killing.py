"""Work killed with SIGKILL over and over and begun again, until it ends: `python -m tests.agents.killing NAME FOLDER`.

Each process is a fork of this one, which has imported all that the work imports and started no thread: a fork of a
process with threads (of autograd, of TensorBoard's writer) may crash. It is killed where it puts a file in its place
(`os.replace`, as `soil_env._io.files.replace_file` does), before or after that.
"""

import faulthandler
import os
import signal
import sys
import traceback
from pathlib import Path

MOST = 120  # processes
MOMENTS = ((1, "after"), (2, "before"), (2, "after"), (6, "before"), (5, "after"))  # of a process, in files; in turn


def status_of(work) -> int:
    """Status, as of `os.waitpid`, of a forked process that does `work`."""
    child = os.fork()
    if child == 0:
        status = 1
        try:
            work()
            status = 0
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stderr.flush()
            os._exit(status)
    return os.waitpid(child, 0)[1]


def killed_until_done(work) -> int:
    """Number of processes that `work` took; RuntimeError where one failed otherwise, or they come to no end."""

    def killed_work():
        kill_at_a_file(*MOMENTS[count % len(MOMENTS)])
        work()

    for count in range(MOST):
        status = status_of(killed_work)
        if status == 0:
            return count
        if not (os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGKILL):
            raise RuntimeError(f"process {count} ended with status {status}")
    raise RuntimeError(f"{MOST} processes, and no end")


def kill_at_a_file(number: int, when: str) -> None:
    """Let this process be killed before or after it puts its file of that number (from 1) in its place."""
    replace, seen = os.replace, []

    def die() -> None:
        os.kill(os.getpid(), signal.SIGKILL)

    def replaced(source, target):
        seen.append(target)
        if (len(seen), when) == (number, "before"):
            die()
        replace(source, target)
        if len(seen) == number:
            die()

    os.replace = replaced


def load_study() -> None:
    """Import what the study imports, so that the forks need not."""
    import optuna  # noqa: F401
    import torch

    import soil_env_agents.study.command
    import soil_env_agents.training  # noqa: F401

    torch.set_num_threads(1)
    torch.optim.Adam([torch.zeros(1)])  # imports a good deal when it is first used


def small_study(folder: Path) -> None:
    """A small study of `agents.study`, whose trainings begin anew after a kill."""
    from soil_env.cli import main as soil_env
    from tests.agents.test_study import config

    train = {"timesteps": 192, "ppo": {"num_envs": 4, "n_steps": 16, "batch_size": 32, "n_epochs": 1, "layer": 4}}
    beside = folder.parent / "config"
    beside.mkdir(exist_ok=True)
    path = config(beside, train=train, courses=3, seeds=1)
    if soil_env(["study", "--config", str(path), "--out", str(folder)]) != 0:
        raise RuntimeError("soil-env study failed")


def load_discovery() -> None:
    """Import what the benchmark imports."""
    import benchmarks.discovery.__main__  # noqa: F401


def discovery(folder: Path) -> None:
    """Three small cases of `benchmarks.discovery`, drawn, answered and scored."""
    from benchmarks.discovery.__main__ import main as discovery

    groups = (word for name in ("none-few-10", "one-few-10", "one-poor-10") for word in ("--group", name))
    asked = ["--entrant", "bic", "--seed", "100007", "--limit", "30", *groups]
    if discovery(["run", *asked, "--out", str(folder)]) != 0:
        raise RuntimeError("benchmarks.discovery failed")


def main(name: str, folder: Path) -> None:
    """Do the work of that name in folder/calm, and killed and begun again in folder/killed.

    Both are done in folder/work, whose name some results have in them.
    """
    faulthandler.enable()
    load, work = {"study": (load_study, small_study), "discovery": (load_discovery, discovery)}[name]
    load()
    if (status := status_of(lambda: work(folder / "work"))) != 0:
        raise RuntimeError(f"undisturbed work ended with status {status}")
    (folder / "work").rename(folder / "calm")
    print(killed_until_done(lambda: work(folder / "work")))
    (folder / "work").rename(folder / "killed")


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
