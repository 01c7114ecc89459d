"""RecurrentPPO of sb3-contrib: an agent with a memory, which may learn to identify the soil by itself.

One LSTM serves policy and value; its sequences are the rollouts of single wheels, cut at the ends of episodes. Models
are built, saved and resumed by `agents.ppo`, with `algorithm="recurrent_ppo"`.
"""

from __future__ import annotations

from soil_env._io.loading import ParameterError

from .config import PPOConfig


def algorithm() -> type:
    """RecurrentPPO; ParameterError where sb3-contrib is not installed."""
    try:
        from sb3_contrib import RecurrentPPO
    except ImportError:
        raise ParameterError("recurrent_ppo: needs sb3-contrib; expected: pip install 'soil_env[recurrent]'") from None
    return RecurrentPPO


def network(config: PPOConfig) -> dict:
    """Arguments of its policy, MlpLstmPolicy."""
    return {
        "lstm_hidden_size": config.layer,
        "shared_lstm": True,
        "enable_critic_lstm": False,
        "net_arch": [config.layer],
    }
