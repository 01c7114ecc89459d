"""benchmarks.law_error_world: errors of the stress laws as a law of forces."""

import numpy as np
import pytest

from benchmarks import law_error_world as made
from soil_env.parameters import load_scenario, soils
from soil_env.terramechanics.model import WheelSoilModel

SCENARIO = load_scenario("two_lines")


def test_the_world_changes_forces_as_the_errors_do(tmp_path):
    """Pull and torque that the model of the file adds, against the contact with errors in its integrals."""
    out = tmp_path / "world.yaml"
    assert made.main(["--seed", "3", "--out", str(out)]) == 0
    assert "--seed 3 --out" in out.read_text().splitlines()[1]
    world, preset = WheelSoilModel.load(out), soils()["lunar_nominal"]
    slip, change, _ = made.changes(SCENARIO, 0.1, 3)
    w = SCENARIO.wheel
    at = {"slip": slip, "load": 150.0, "speed": 0.2}
    plain = WheelSoilModel(world.wheel, preset).predict(at)
    off = WheelSoilModel(world.wheel, preset, {}, world.residual).predict(at)
    law = np.stack([off.drawbar_pull - plain.drawbar_pull, (off.torque - plain.torque) / w.radius], axis=1) / 150.0
    whole, left = np.mean(change**2, axis=0), np.mean((change - law) ** 2, axis=0)
    assert np.all(np.sqrt(whole) > 0.01)  # 10 % of the stresses are some percent of the load
    assert np.all(left < 0.1 * whole)
    assert np.allclose(np.mean(change - law, axis=0), 0.0, atol=1e-6)  # least squares with a constant


def test_errors_grow_with_their_size():
    """To first order in size, and none without."""
    small, large = (made.changes(SCENARIO, size, 5)[1] for size in (1e-3, 2e-3))
    assert np.allclose(large, 2.0 * small, rtol=0.05, atol=1e-6)
    assert np.abs(small).max() > 1e-5


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [(["--size", "0"], "--size = 0"), (["--size", "nan"], "--size = nan"), (["--scenario", "mars"], "mars")],
)
def test_bad_input_is_refused_in_one_line(arguments, expected, tmp_path, capsys):
    assert made.main([*arguments, "--out", str(tmp_path / "w.yaml")]) == 2
    err = capsys.readouterr().err
    assert err.startswith("benchmarks.law_error_world: ") and err.count("\n") == 1 and expected in err
    assert not list(tmp_path.iterdir())
