# %% [markdown]
# # Drive and render
#
# One wheel crosses ten metres of soil that it does not know. The identifier reads its sensors and
# estimates the soil on the way.

# %%
import gymnasium
import matplotlib.pyplot as plt
import numpy as np

env = gymnasium.make("soil_env:SoilWheel-v0", render_mode="rgb_array")
observation, info = env.reset(seed=1)
print(env.action_space, env.observation_space.shape)

# %% [markdown]
# The action is the rate of the rim speed, as a share of 0.3 m/s². Drive with a constant one and
# keep what happens. The pictures are drawn only when `render` is called.

# %%
rows = []
picture = None
over = False
while not over:
    observation, reward, terminated, truncated, info = env.step([0.3])
    state, estimate = info["state"], info["estimate"]
    rows.append(
        {
            "x": state["x"],
            "slip": state["slip"],
            "sinkage": 1000.0 * state["sinkage"],
            "phi": estimate["friction_angle_deg"],
            "sd": estimate["friction_angle_sd_deg"],
            "true": env.unwrapped.true_soil().friction_angle_deg,
            "reward": reward,
        }
    )
    if picture is None and state["x"] > 4.0:
        picture = env.render()
    over = terminated or truncated
drive = {name: np.array([row[name] for row in rows]) for name in rows[0]}
print(f"{info['cause']} at {drive['x'][-1]:.2f} m, return {drive['reward'].sum():.2f}")

# %% [markdown]
# The picture at four metres: normal and shear stress under the rim, the rut, the course with its
# soils; right, what the identifier thinks (dark) and what is true (pale).

# %%
plt.figure(figsize=(9.6, 5.4))
plt.imshow(picture)
plt.axis("off")
plt.tight_layout(pad=0)
plt.show()

# %% [markdown]
# The drive over the distance. The identifier never sees the true soil; its interval is one standard
# deviation.

# %%
figure, (motion, soil) = plt.subplots(2, 1, sharex=True, figsize=(8, 5))
motion.plot(drive["x"], drive["slip"], label="slip [-]")
motion.plot(drive["x"], drive["sinkage"] / 100.0, label="sinkage [dm]")
motion.legend()
soil.fill_between(
    drive["x"], drive["phi"] - drive["sd"], drive["phi"] + drive["sd"], alpha=0.3, label="one sd"
)
soil.plot(drive["x"], drive["phi"], label="identified")
soil.plot(drive["x"], drive["true"], "k--", label="true")
soil.set(xlabel="distance [m]", ylabel="friction angle [deg]")
soil.legend()
plt.show()
env.close()

# %% [markdown]
# Next: [every number of the environment](../guide/environment.md), [pictures and videos from the
# command line](../guide/rendering.md), [rovers](../guide/rover.md),
# [controllers](../guide/controllers.md).
