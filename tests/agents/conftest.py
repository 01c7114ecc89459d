"""Models, and a finished evaluation of them by `soil-env evaluate`."""

import pytest

from tests.agents.evaluating import make_done, make_models


@pytest.fixture(scope="session")
def models(tmp_path_factory):
    return make_models(tmp_path_factory.mktemp("models"))


@pytest.fixture(scope="session")
def done(models, tmp_path_factory):
    return make_done(models, tmp_path_factory.mktemp("done") / "made" / "here")
