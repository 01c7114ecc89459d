"""Markers by folder, headless drawing, and fixtures for tests that start other processes."""

import gc
import os
import signal
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

TESTS = Path(__file__).resolve().parent
ROOT = TESTS.parent
PYTHONPATH = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])

for name, value in (
    ("SDL_VIDEODRIVER", "dummy"),
    ("SDL_AUDIODRIVER", "dummy"),
    ("MPLBACKEND", "Agg"),
):
    os.environ.setdefault(name, value)
for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    # Matrices and networks are small, and as many tests run as there are cores.
    os.environ.setdefault(name, "1")

# The same examples on every machine; `--hypothesis-profile default` draws others.
settings.register_profile(
    "same", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("same")

# A shell starts what runs in the background with Ctrl-C ignored, and processes started from here
# would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark the tests of tests/benchmarks as `benchmarks`."""
    for item in items:
        if (TESTS / "benchmarks") in item.path.parents:
            item.add_marker("benchmarks")


def pytest_collection():
    """Switch the garbage collector off during collection: what is collected stays in use."""
    gc.disable()


def pytest_collection_finish():
    """Exempt what was collected from garbage collection for good, and switch the collector on."""
    gc.freeze()
    gc.enable()


@pytest.fixture()
def importable(monkeypatch):
    """Let processes started by a test import the packages and the tests, from any folder."""
    monkeypatch.setenv("PYTHONPATH", PYTHONPATH)


@pytest.fixture()
def unrendered(monkeypatch):
    """Let figures be composed but not drawn: drawing can take longer than the computation."""
    from matplotlib.figure import Figure

    monkeypatch.setattr(Figure, "draw", lambda figure, renderer: None)


@pytest.fixture(scope="session")
def cluster():
    """A Ray cluster of two nodes of one CPU each, on this machine."""
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    patch = pytest.MonkeyPatch()
    patch.setenv("PYTHONPATH", PYTHONPATH)
    cluster = Cluster(
        initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False}
    )
    cluster.add_node(num_cpus=1)
    cluster.wait_for_nodes()
    yield cluster
    cluster.shutdown()
    patch.undo()


@pytest.fixture()
def connected(cluster):
    """Ray, connected to the cluster."""
    import ray

    ray.init(address=cluster.address, log_to_driver=False, logging_level="ERROR")
    yield ray
    ray.shutdown()
