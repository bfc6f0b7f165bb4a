"""The share of tests that wait for processes of ROS, which cost most of the suite's time."""

from __future__ import annotations

import pytest

# One that starts nodes or a session takes some 4 to 20 s of processor time, one in this process
# a twentieth of a second.
MOST = 200


def test_at_most_200_tests_start_processes_of_ros(request: pytest.FixtureRequest) -> None:
    """Only the tests that this run has collected count, so all of them if all are run."""
    starting = [
        item.nodeid
        for item in request.session.items
        if item.get_closest_marker("ros") or item.get_closest_marker("system")
    ]
    assert len(starting) <= MOST, (
        f"{len(starting)} tests start ROS nodes or sessions; show in one process what shows there "
        "as well (ssp_scenario_manager.run.in_process, tests/support/bags/worlds.py)"
    )
