# %% [markdown]
# # Own wheel and soil
#
# A wheel and a soil of your own: what the wheel can pull and climb, and a course on it.

# %%
import gymnasium
import matplotlib.pyplot as plt
import numpy as np
import yaml

from soil_env.parameters import Soil, to_dict
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel

beach = Soil(
    friction_angle_deg=31.0,
    cohesion=800.0,  # Pa
    shear_modulus=0.02,  # m
    sinkage_exponent=1.0,
    sinkage_coefficient=9e5,  # N/m^(n+2)
    density=1550.0,  # kg/m3
    dig_gain=2.0,  # of slip-sinkage
    gravity_measured=9.81,  # m/s2
)

# %% [markdown]
# Two wheels of the same load. The wide one sinks less.

# %%
slip = np.linspace(0.0, 0.8, 40)
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.5))
for width in (0.08, 0.2):
    model = WheelSoilModel(ModelWheel(0.15, width), beach, {})
    found = model.predict({"slip": slip, "load": 120.0})
    left.plot(slip, found.drawbar_pull, label=f"{100 * width:.0f} cm wide")
    right.plot(slip, 1000 * found.sinkage)
    best = found.drawbar_pull.argmax()
    slope = np.degrees(np.arctan(found.drawbar_pull[best] / 120.0))
    pull = found.drawbar_pull[best]
    print(f"{100 * width:3.0f} cm: at most {pull:.0f} N, at slip {slip[best]:.2f}; {slope:.0f} deg")
left.set(xlabel="slip", ylabel="drawbar pull [N]")
right.set(xlabel="slip", ylabel="sinkage [mm]")
left.legend()
plt.tight_layout()
plt.show()

# %% [markdown]
# A course of this soil and a shipped one, on the wide wheel. Any key of a scenario is a keyword;
# `soil-env describe scenario` lists them.

# %%
env = gymnasium.make(
    "soil_env:SoilWheel-v0",
    scenario="mixed",
    wheel={"radius": 0.15, "width": 0.2},
    own_soils={"beach": beach},
    soils={"beach": 3, "dry_sand": 1},
    course={"length": 5.0},
)
observation, info = env.reset(seed=1)
over = False
while not over:
    observation, reward, terminated, truncated, info = env.step([0.3])
    over = terminated or truncated
print(f"{info['cause']} at {info['state']['x']:.2f} m")

# %% [markdown]
# The same as a file, for every command: `soil-env drive --scenario beach.yaml --out beach.gif`.

# %%
with open("beach.yaml", "w") as stream:
    yaml.safe_dump(to_dict(env.unwrapped.scenario), stream)

# %% [markdown]
# Next: [scenarios](../guide/scenarios.md), [effects that a soil may have](../physics/effects.md),
# [controllers](../guide/controllers.md).
