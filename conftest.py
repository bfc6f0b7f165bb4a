"""Puts the real packages into sys.modules before any test file is imported.

Under ``--import-mode=importlib`` pytest names ``ssp_eval/test/test_x.py`` the module
``ssp_eval.test.test_x`` and would make a namespace module of the folder ``ssp_eval/``, which then
hides the package ``ssp_eval/ssp_eval/`` from the tests.
"""

from __future__ import annotations

import gc
import importlib
import os
import sys
import time
from collections.abc import Generator, Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# Tests replace functions of modules, which compiled modules call directly.
os.environ["SSP_INTERPRETED"] = "1"

import ssp_core
from ssp_core.host.environment import session_environment
from tests.support.order import spread

# The same examples in every run, so that a change is judged by what it changed. To look for new
# ones: SSP_EXPLORE=1 ./ssp test. How long an example takes says more of the machine than of us.
_ANY_TIME = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("same", _ANY_TIME, derandomize=True)
settings.register_profile("explore", _ANY_TIME)
settings.load_profile("explore" if os.environ.get("SSP_EXPLORE") else "same")

# As ssp_vla_bridge.egodriver sets it, but before a test loads gRPC by itself.
os.environ.setdefault("GRPC_ENABLE_FORK_SUPPORT", "0")

for _name in (
    "ssp_msgs",
    "ssp_scenario_manager",
    "ssp_ot_controller",
    "ssp_monitor",
    "ssp_vla_bridge",
    "ssp_eval",
):
    # ssp_msgs holds generated code and is missing where ROS is.
    if find_spec(_name) is not None:
        importlib.import_module(_name)

# The nodes of tests discover each other as those of sessions do. With the middleware's own settings
# two that start at once may miss each other, and meet 3 s later. A process reads them once.
_SETTINGS = "FASTRTPS_DEFAULT_PROFILES_FILE"
_PROFILE = Path(ssp_core.__file__).parent / "config" / "fastdds_one_host.xml"
_of_sessions = session_environment(0, _PROFILE)
if _SETTINGS in _of_sessions:
    os.environ[_SETTINGS] = _of_sessions[_SETTINGS]

# CARLA's client has no wheel for a later Python. On the others its absence fails these tests.
_NEWEST_OF_CARLA = (3, 12)
_HAS_CARLA = sys.version_info[:2] <= _NEWEST_OF_CARLA


def pytest_report_header() -> str | None:
    """Say in one line that the tests of CARLA are left out, where they are."""
    if _HAS_CARLA:
        return None
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    return f"CARLA's client has no wheel for Python {version}: the tests marked carla are left out"


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collect tests without looking for cycles, and never look through the collected ones.

    They stay until the end, and the search takes a third of the time that collecting them takes.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave the tests of CARLA out where its client can't be, and order what several workers take.

    Each worker collects all tests.
    """
    if not _HAS_CARLA:
        left_out = [item for item in items if item.get_closest_marker("carla")]
        items[:] = [item for item in items if not item.get_closest_marker("carla")]
        config.hook.pytest_deselected(items=left_out)
    if hasattr(config, "workerinput"):
        items[:] = spread(items)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--within",
        type=float,
        metavar="SECONDS",
        help="start no test later than this; the rest is reported as skipped",
    )


_STARTED = time.monotonic()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    within_s = item.config.getoption("--within")
    if within_s is not None and time.monotonic() - _STARTED > within_s:
        pytest.skip(f"not started within {within_s:g} s")


# Modules that run sessions in this process.
_SIMULATING = (
    "run.feasibility",
    *(f"closed_loop.{name}" for name in ("starts.start", "campaigns.runs", "single_run.single")),
)


@pytest.fixture(scope="session", autouse=True)
def _simulated_once(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Let runs that several tests need be simulated once, where test files that were read do so."""
    place = sys.modules.get("ssp_scenario_manager.compile.place")
    if place is None:
        yield
        return
    from tests.support.simulated_once import remembered, run_once

    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "simulated_once"
    folder.mkdir(exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        for name in _SIMULATING:
            if (module := sys.modules.get(f"ssp_scenario_manager.{name}")) is not None:
                patch.setattr(module, "run_in_process", run_once)
        patch.setattr(place, "why_not", remembered(place.why_not, folder))
        yield
