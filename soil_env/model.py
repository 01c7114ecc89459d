"""Public path of `soil_env.terramechanics.model`: a wheel on one soil as an object and as a file."""

from soil_env.terramechanics.model import ModelWheel, Prediction, WheelSoilModel, load_model
from soil_env.terramechanics.residual import ResidualTerm
from soil_env.terramechanics.validity import OutsideValidity

__all__ = ["ModelWheel", "OutsideValidity", "Prediction", "ResidualTerm", "WheelSoilModel", "load_model"]
