# %% [markdown]
# # Identify a table
#
# The soil of a measured table, with intervals, and a wheel that drives on it. The table is
# synthetic: its soil is known.

# %%
import gymnasium
import matplotlib.pyplot as plt
import numpy as np

from soil_env.identification.table import identify_table
from soil_env.measurement import read_setup, read_table

setup = read_setup("data/setup.yaml")
table = read_table("data/single_wheel.csv", setup.wheel)
estimate = identify_table(table, setup)
print("warnings:", estimate.warnings or "none")

# %% [markdown]
# Read the warnings first. Then the numbers: `sd over prior` near 1 says that the table tells
# nothing of this parameter.

# %%
TRUE = {
    "friction_angle_deg": 31.0,
    "shear_modulus": 0.018,
    "sinkage_coefficient": 9e5,
    "sinkage_exponent": 0.9,
    "cohesion": 1500.0,
}
for name, value in TRUE.items():
    found = estimate.parameters[name]
    print(
        f"{name:20s} {found.value:10.4g}   95 % {found.low:9.4g} .. {found.high:9.4g}   "
        f"true {value:<7g} sd over prior {found.sd_over_prior:.2f}"
    )

# %% [markdown]
# A wheel on this soil predicts what was measured, and what was not.

# %%
model = estimate.model(setup.wheel)
slip = np.linspace(0.0, 0.8, 40)
for load in np.unique(np.round(table.load)):
    pull = model.predict({"slip": slip, "load": load}).drawbar_pull
    (line,) = plt.plot(slip, pull, label=f"{load:.0f} N")
    rows = np.round(table.load) == load
    plt.plot(table.slip[rows], table.drawbar_pull[rows], "o", color=line.get_color())
plt.xlabel("slip")
plt.ylabel("drawbar pull [N]")
plt.legend(title="load")
plt.show()

# %% [markdown]
# The same soil as an environment: exactly this wheel on exactly this soil.

# %%
env = gymnasium.make("soil_env:SoilWheel-v0", scenario="mixed", model=model)
observation, info = env.reset(seed=1)
print(info["world"]["soil"])
