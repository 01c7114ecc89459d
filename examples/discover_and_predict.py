# %% [markdown]
# # Discover and predict
#
# A table that the base model does not fit, which effect is missing, and what the corrected model
# says of runs that were not made. The table is synthetic, from a program apart from soil_env, in
# which slip-sinkage is hidden.

# %%
import gymnasium
import matplotlib.pyplot as plt
import numpy as np
from rich.console import Console

from soil_env.discovery import run
from soil_env.discovery.report import show

report = run("data/rig.csv", "data/rig.setup.yaml")
show(report, Console(width=100, color_system=None, force_jupyter=False))

# %% [markdown]
# That is what `soil-env discover data/rig.csv --setup data/rig.setup.yaml --out rig` prints; it
# also writes a report with plots. As numbers:

# %%
print(report.verdict)
for effect in report.effects:
    print(effect.name, effect.form, f"probability {effect.probability:.3f}")
    for name, found in effect.parameters.items():
        print(f"  {name} {found.value:.5f}, 95 % {found.low:.5f} .. {found.high:.5f}")

# %% [markdown]
# In a picture: the first pass on fresh soil at the middle load and speed.

# %%
table = report.problem.data.table
middle = (
    (table.passes == 1)
    & (table.load == np.median(table.load))
    & (table.speed == np.median(table.speed))
)
at = {
    "slip": np.linspace(0.04, 0.57, 30),
    "load": np.median(table.load),
    "speed": np.median(table.speed),
    "pass": 1,
}
plt.plot(table.slip[middle], 1000 * table.sinkage[middle], "ko", label="measured")
plt.plot(at["slip"], 1000 * report.base_model.predict(at).sinkage, "--", label="base model")
plt.plot(at["slip"], 1000 * report.model.predict(at).sinkage, label="corrected model")
plt.xlabel("slip")
plt.ylabel("sinkage [mm]")
plt.legend()
plt.show()

# %% [markdown]
# Predictions of runs that were not made, with the standard deviations of a measurement. They hold
# whatever the verdict is.

# %%
runs = {"slip": np.array([0.2, 0.4]), "load": 80.0, "speed": 0.05, "pass": 1}
found = report.model.predict(runs)
for k, slip in enumerate(runs["slip"]):
    z_sd, pull_sd, torque_sd = found.sd[k]
    print(
        f"slip {slip:.1f}: sinkage {1000 * found.sinkage[k]:.1f} ({1000 * z_sd:.1f}) mm, "
        f"pull {found.drawbar_pull[k]:.1f} ({pull_sd:.1f}) N, "
        f"torque {found.torque[k]:.2f} ({torque_sd:.2f}) N m"
    )

# %% [markdown]
# What to measure next, and the corrected model as a world to drive in, with a weight on the wheel
# that was measured.

# %%
for test in report.next_tests[:2]:
    print({name: round(value, 3) for name, value in test.conditions.items()})
report.model.save("model.yaml")
wheel = {"body_mass": 7.0}  # [kg] of the loads that were measured
options = {"scenario": "mixed", "wheel": wheel, "model": "model.yaml", "scatter": True}
env = gymnasium.make("soil_env:SoilWheel-v0", **options)
observation, info = env.reset(seed=1)
print(info["world"]["effects"])
