"""What is given of wheel, ground, sensors and task: frozen dataclasses in SI units, and presets.

Presets with their sources: configs/soils.yaml, configs/wheels.yaml, configs/scenarios/*.yaml and
configs/rovers/*.yaml. `SoilState` is the plain tuple in which compiled code takes a soil.
"""

from soil_env._io.loading import ParameterError, config_dir, to_dict

from .belief import Belief
from .course import MOST_CLASSES, Camera, CourseSpec
from .rover import DEFAULT_ROVER, RoverScenario, load_rover, rover_names
from .scenario import DEFAULT_SCENARIO, Scenario, load_scenario, scenario_names
from .sensors import Noise, SensorReading
from .soil import (
    EARTH_GRAVITY,
    FLOW_LAW,
    NO_LAYER,
    Layer,
    Soil,
    SoilSpread,
    SoilState,
    UnstatedGravity,
    lumped_coefficient,
    soils,
)
from .task import ACTION_PERIODS, Control, Limits, RewardWeights
from .vehicle import MOST_AXLES, Vehicle
from .wheel import LARGEST_WHEEL, Tyre, Wheel, check_lugs, geared, wheels, with_preset

__all__ = [
    "DEFAULT_ROVER",
    "DEFAULT_SCENARIO",
    "EARTH_GRAVITY",
    "FLOW_LAW",
    "ACTION_PERIODS",
    "LARGEST_WHEEL",
    "MOST_AXLES",
    "MOST_CLASSES",
    "NO_LAYER",
    "Belief",
    "Camera",
    "Control",
    "CourseSpec",
    "Layer",
    "Limits",
    "Noise",
    "ParameterError",
    "RewardWeights",
    "RoverScenario",
    "Scenario",
    "SensorReading",
    "Soil",
    "SoilSpread",
    "SoilState",
    "Tyre",
    "UnstatedGravity",
    "Vehicle",
    "Wheel",
    "check_lugs",
    "config_dir",
    "geared",
    "load_rover",
    "load_scenario",
    "lumped_coefficient",
    "rover_names",
    "scenario_names",
    "soils",
    "to_dict",
    "wheels",
    "with_preset",
]
