"""Reports that several tests look at."""

import pytest

from soil_env.discovery import run
from soil_env.discovery.prediction import fit_prediction
from tests.discovery.files import LOADS, PLANTED, problem_of, table_text, write_files


@pytest.fixture(scope="session")
def planted_files(tmp_path_factory):
    """(report, folder of its files) of a table with slip-sinkage."""
    folder = tmp_path_factory.mktemp("planted")
    return run(*write_files(folder, table_text(PLANTED)), folder / "out", seed=1), folder / "out"


@pytest.fixture(scope="session")
def planted(planted_files):
    """Report of a table with slip-sinkage."""
    return planted_files[0]


@pytest.fixture(scope="session")
def nothing(tmp_path_factory):
    """Report of a table of the base model, in a folder whose name a page has to escape."""
    folder = tmp_path_factory.mktemp("nothing") / "<b>&"
    folder.mkdir()
    return run(*write_files(folder, table_text({}, loads=(100, 200))))


@pytest.fixture(scope="session")
def planted_problem(tmp_path_factory):
    """Calibrated problem of a table with slip-sinkage."""
    return problem_of(tmp_path_factory.mktemp("problem"), table_text(PLANTED, loads=LOADS))


@pytest.fixture(scope="session")
def learnt(planted_problem):
    """Prediction of the calibrated problem."""
    return fit_prediction(planted_problem)
