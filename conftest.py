"""Puts the real packages into sys.modules before any test file is imported.

Under ``--import-mode=importlib`` pytest names ``ssp_eval/test/test_x.py`` the module
``ssp_eval.test.test_x`` and would make a namespace module of the folder ``ssp_eval/``, which then
hides the package ``ssp_eval/ssp_eval/`` from the tests.
"""

from __future__ import annotations

import importlib
import os
from importlib.util import find_spec

import pytest
from hypothesis import settings

# The same examples in every run, so that a change is judged by what it changed. To look for new
# ones: SSP_EXPLORE=1 ./ssp test.
settings.register_profile("same", derandomize=True)
settings.register_profile("explore")
settings.load_profile("explore" if os.environ.get("SSP_EXPLORE") else "same")

for _name in (
    "ssp_core",
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


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests of real processes over DDS get a second and a third chance, and the report says so.

    What they check is decided by deadlines on the wall's clock, on machines that others use too.
    """
    for item in items:
        if item.get_closest_marker("ros") or item.get_closest_marker("system"):
            item.add_marker(pytest.mark.flaky(reruns=2))
