# %% [markdown]
# # Read a log
#
# A drive as a rover would record it, a CSV file with time stamps, and what the log says of the
# soil. Bags of ROS 2, MCAP and Parquet are read in the same way.

# %%
import csv

import gymnasium
import matplotlib.pyplot as plt
import numpy as np
import yaml

from soil_env.logs import read_map, read_recording, replay, steady_windows

env = gymnasium.make("soil_env:SoilWheel-v0", scenario="mixed", action="torque", scaled=False)
wheel = env.unwrapped.scenario.wheel
weight = env.unwrapped.scenario.weight
names = env.unwrapped.observation_names
top_speed = wheel.radius * wheel.no_load_speed
#: Column -> (entry of the observation, its scale to SI units).
COLUMNS = {
    "wheel_speed": ("rim_speed", wheel.no_load_speed),
    "speed": ("speed", top_speed),
    "sinkage": ("sinkage", wheel.radius),
    "drawbar_pull": ("drawbar_pull", weight),
    "load": ("load", weight),
    "torque": ("torque", weight * wheel.radius),
    "pitch": ("pitch", 1.0),
}
observation, info = env.reset(seed=4)
true = []
over = False
with open("drive.csv", "w", newline="") as stream:
    log = csv.writer(stream)
    log.writerow(["t", *COLUMNS])
    while not over:
        time = 0.1 * len(true)
        observation, _, terminated, truncated, info = env.step([0.35 + 0.2 * np.sin(1.5 * time)])
        values = (scale * observation[names.index(entry)] for entry, scale in COLUMNS.values())
        log.writerow([f"{time:.1f}", *(f"{value:.6g}" for value in values)])
        true.append(env.unwrapped.true_soil().friction_angle_deg)
        over = terminated or truncated
print(f"{len(true)} rows, {info['cause']}")

# %% [markdown]
# The map says what each column is. It also takes units, signs, offsets and errors of sensors;
# `soil-env describe map` lists the keys.

# %%
content = {
    "wheel": {name: getattr(wheel, name) for name in ("radius", "width", "body_mass", "inertia")},
    "time": {"column": "t", "unit": "s"},
    "channels": {name: {"column": name} for name in COLUMNS},
}
with open("drive.map.yaml", "w") as stream:
    yaml.safe_dump(content, stream, sort_keys=False)

log_map = read_map("drive.map.yaml")
recording = read_recording("drive.csv", log_map)
found = replay(recording, log_map)
print("doubts:", recording.doubts or "none")
print("grounds:", found.ground.max(), " borders:", found.borders)
print("steady points:", len(steady_windows(recording, log_map, found.ground).rows))

# %% [markdown]
# The soil under the wheel over time, and the true one, which no rover knows.

# %%
phi, sd = found.values["friction_angle_deg"], found.values["friction_angle_sd_deg"]
plt.figure(figsize=(8, 3))
plt.fill_between(found.time, phi - sd, phi + sd, alpha=0.3, label="one sd")
plt.plot(found.time, phi, label="from the log")
plt.plot(found.time, true[: len(phi)], "k--", label="true")
plt.xlabel("time [s]")
plt.ylabel("friction angle [deg]")
plt.legend()
plt.tight_layout()
plt.show()

# %% [markdown]
# `soil-env logs drive.csv --map drive.map.yaml --out report` writes a report with these pictures,
# and the steady points as a measurement table for [identification](../guide/identify.md) and
# [discovery](../guide/discovery.md). A bag of ROS 2: `record_bag.py`. More:
# [logs](../guide/logs.md).
