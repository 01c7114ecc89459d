"""Trained agents as one ONNX file that runs without torch, Stable-Baselines3 and soil_env: `python -m agents.export`.

Here: the names of the files of an export, beside `agents.exported.POLICY`.
"""

DESCRIPTION, COURSE, RUNNER, CARD = "policy.yaml", "course.npz", "run_policy.py", "README.md"
ENV = "SoilWheel-v0"


def zip_name(description: dict) -> str:
    """Name of the model's file as `huggingface_sb3` has it, "ppo-SoilWheel-v0.zip"."""
    return f"{str(description.get('algorithm')).lower()}-{ENV}.zip"
