"""Trained agents as one ONNX file that runs without torch, Stable-Baselines3 and soil_env:
`soil-env export`.
"""
