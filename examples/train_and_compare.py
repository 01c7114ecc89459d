# %% [markdown]
# # Train and compare
#
# An agent is trained and drives the same courses as two rules. Needs
# `pip install "soil_env[train]"`. This training is of seconds: it shows how it is done, and its own
# figures mean nothing. `soil-env train` makes an agent of use in a few minutes.

# %%
import tempfile

import matplotlib.pyplot as plt

from soil_env_agents.config import PPOConfig, TrainConfig
from soil_env_agents.controllers import make_controller
from soil_env_agents.evaluate.driving import run_courses
from soil_env_agents.evaluate.statistics import wilson
from soil_env_agents.training import make_run_folder, scenario_of, train

config = TrainConfig(
    scenario="two_lines",
    observation="identified",
    timesteps=16384,
    student=0.0,  # PPO alone; by default an agent first learns from a rule that knows the soil
    seed=0,
    ppo=PPOConfig(num_envs=64, n_steps=128, batch_size=2048),
    runs=tempfile.mkdtemp(),
)
scenario = scenario_of(config)
agent = train(make_run_folder(config, scenario), config, scenario)

# %% [markdown]
# On `two_lines` most patches have two routes, and often only one is passable. A rule that knows
# nothing of the soil takes one by chance. Course k of a set is the same for everybody.

# %%
drivers = {
    "this agent": agent,
    "soft start": make_controller("soft_start", scenario),
    "best slip, identified soil": make_controller("best_slip_identified", scenario),
}
COURSES = 100
finished = {
    name: run_courses(driver, scenario, seed=7, courses=COURSES).metric("finished").sum()
    for name, driver in drivers.items()
}
for name, count in finished.items():
    low, high = wilson(count, COURSES)
    print(f"{name:27s}{100 * count / COURSES:4.0f} % finished [{100 * low:.0f}, {100 * high:.0f}]")

# %% [markdown]
# The intervals are 95 % intervals over courses (Wilson). Differences on the same courses are known
# better: `soil-env evaluate` prints them paired.

# %%
shares = [count / COURSES for count in finished.values()]
ends = [wilson(count, COURSES) for count in finished.values()]
errors = [
    [share - low for share, (low, _) in zip(shares, ends, strict=True)],
    [high - share for share, (_, high) in zip(shares, ends, strict=True)],
]
plt.figure(figsize=(8, 3))
plt.barh(list(finished), shares, xerr=errors, capsize=3)
plt.xlabel("share of courses finished")
plt.xlim(0, 1)
plt.tight_layout()
plt.show()

# %% [markdown]
# Next: [training](../guide/training.md), [evaluation](../guide/evaluation.md), [the shipped
# agent](../guide/default_policy.md), [how good it is](../results.md).
