"""Public path of `soil_env.simulation.task`: observation layout, reward terms, causes of an episode's end."""

from soil_env.simulation.task import REWARD_TERMS, VARIANTS, Cause, layout

__all__ = ["REWARD_TERMS", "VARIANTS", "Cause", "layout"]
