"""Runs the exported policy beside this file. Needs numpy and onnxruntime, nothing else.

    python run_policy.py            drives the recorded steps of course.npz and compares with the
                                    agent; time a step
    python run_policy.py --serve    a line of numbers (an observation) on stdin -> a line (the
                                    action) on stdout; after an empty line a new course begins;
                                    a line of anything else ends it with status 2

The order, units and bounds of the numbers are in policy.yaml.
"""

import sys
import time
from pathlib import Path

import numpy as np
import onnxruntime

HERE = Path(__file__).resolve().parent


class Policy:
    """The policy of an ONNX file, on one thread."""

    def __init__(self, path=HERE / "policy.onnx"):
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.inter_op_num_threads = 1
        options.log_severity_level = 3  # errors
        self.session = onnxruntime.InferenceSession(
            str(path), options, providers=["CPUExecutionProvider"]
        )
        own = {x.name: x for x in self.session.get_inputs()}
        self.size = own["observation"].shape[1]
        # Numbers kept from step to step.
        self.kept = own["history"].shape[1] if "history" in own else 0

    def act(self, observation, memory=None, new_course=None):
        """(actions [n, 1] in [-1, 1], memory [n, kept]) for float32 observations [n, D] and the
        last memory.

        `new_course` [n] bool: rows where a course begins; all of them where there is no memory.
        ValueError for rows of another length and numbers that are not finite.
        """
        if observation.shape[1:] != (self.size,) or not np.isfinite(observation).all():
            raise ValueError(f"expected {self.size} finite numbers, those of policy.yaml")
        count = len(observation)
        feeds = {"observation": observation}
        if self.kept:
            feeds["new_course"] = (
                np.full(count, memory is None) if new_course is None else new_course
            )
            feeds["history"] = (
                np.zeros((count, self.kept), np.float32) if memory is None else memory
            )
        action, *kept = self.session.run(None, feeds)
        return action, kept[0] if kept else None


def serve(policy):
    """Answer each line of stdin, an observation, with a line on stdout, the action.

    After an empty line, which has no answer, a new course begins. A line of anything else ends the
    process with status 2.
    """
    memory = None
    for k, line in enumerate(sys.stdin, 1):
        if not line.strip():
            memory = None
            continue
        try:
            action, memory = policy.act(np.array([line.split()], dtype=np.float32), memory)
        except ValueError as error:
            print(f"run_policy.py: error: line {k}: {error}", file=sys.stderr)
            sys.exit(2)
        print(*action[0], flush=True)


def compared(policy, course):
    """Compare a policy with the recorded actions of an agent on the steps of course.npz, `course`.

    Returns the largest difference of the actions, and the time of each step of one wheel [us].
    """
    memory = None
    worst = 0.0
    times = []
    for seen, fresh, expected in zip(
        course["observation"], course["new_course"], course["action"], strict=True
    ):
        start = time.perf_counter()
        action, memory = policy.act(seen[None], None if fresh else memory)
        times.append(1e6 * (time.perf_counter() - start))
        worst = max(worst, float(abs(action[0] - expected).max()))
    return worst, np.array(times)


if __name__ == "__main__":
    if "--serve" in sys.argv:
        serve(Policy())
    else:
        worst, times = compared(Policy(), np.load(HERE / "course.npz"))
        print(
            f"{len(times)} steps: largest difference {worst:.1e}, {np.median(times):.0f} us a "
            f"step, 99 % within {np.percentile(times, 99):.0f} us"
        )
