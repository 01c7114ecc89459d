"""Runs the exported policy beside this file. Needs numpy and onnxruntime, nothing else.

    python run_policy.py            drives the recorded steps of course.npz: difference from the agent, time a step
    python run_policy.py --serve    a line of numbers (an observation) on stdin -> a line (the action) on stdout; after
                                    an empty line a new course begins

The order, units and bounds of the numbers are in policy.yaml.
"""

import sys
import time
from pathlib import Path

import numpy as np
import onnxruntime

HERE = Path(__file__).resolve().parent


class Policy:
    def __init__(self, path=HERE / "policy.onnx"):
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads, options.log_severity_level = 1, 3
        self.session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        self.states = {x.name: x for x in self.session.get_inputs() if x.name not in ("observation", "new_course")}
        self.reset()

    def reset(self):  # a new course: nothing is remembered
        kinds = {"tensor(float)": np.float32, "tensor(double)": np.float64}
        self.memory = {name: np.zeros((1, *x.shape[1:]), kinds[x.type]) for name, x in self.states.items()}
        self.fresh = True

    def act(self, observation):  # [D] numbers -> [1] numbers in [-1, 1]
        feeds = {"observation": np.asarray(observation, np.float32)[None], **self.memory}
        if self.states:
            feeds["new_course"] = np.array([self.fresh])
        action, *kept = self.session.run(None, feeds)
        self.memory, self.fresh = dict(zip(self.states, kept, strict=True)), False
        return action[0]


policy = Policy()
if "--serve" in sys.argv:
    for line in sys.stdin:
        print(*policy.act(line.split()), flush=True) if line.strip() else policy.reset()
elif __name__ == "__main__":
    course, worst, times = np.load(HERE / "course.npz"), 0.0, []
    for seen, fresh, expected in zip(course["observation"], course["new_course"], course["action"], strict=True):
        policy.reset() if fresh else None
        start = time.perf_counter()
        worst = max(worst, float(abs(policy.act(seen) - expected).max()))
        times.append(1e6 * (time.perf_counter() - start))
    print(f"{len(times)} steps: largest difference {worst:.1e}, {np.median(times):.0f} us a step, "
          f"99 % within {np.percentile(times, 99):.0f} us")  # fmt: skip
