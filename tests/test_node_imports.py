"""A node imports what its ordinary path needs: a session starts ten of them."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from ssp_core.host.environment import session_environment

# Packages that take long to import, or stand for a peer that most sessions don't have.
HEAVY = frozenset(
    (
        *("aiohttp", "av", "cv2", "libsumo", "matplotlib", "numba", "pandas", "rich", "rosbags"),
        *("scipy.interpolate", "scipy.optimize", "shapely", "sumolib", "traci"),
        *("ssp_core.carla.client", "ssp_ot_controller.camera.carla_painter"),
    )
)
# What each node's module may import of them.
NEEDED = {
    "ssp_eval.ros.evaluator_node": {"av", "cv2", "rich", "rosbags"},
    "ssp_monitor.ros.monitor_node": {"rosbags"},
    "ssp_monitor.ros.page_node": {"aiohttp", "rosbags"},
    "ssp_ot_controller.ros.front_camera": {"cv2", "numba"},
    "ssp_ot_controller.ros.object_target": set(),
    "ssp_ot_controller.ros.sil_world": set(),
    "ssp_ot_controller.ros.vut_adapter": set(),
    "ssp_ot_controller.ros.vut_driver": {"rosbags"},
    "ssp_scenario_manager.ros.manager_node": set(),
    "ssp_vla_bridge.ros.vla_bridge": {"cv2", "rosbags"},
}

# One process, parted in two for each node once it has loaded what all nodes share.
_PROGRAM = """
import importlib, json, os, sys
import rclpy.node
for name in sys.argv[1:]:
    sys.stdout.flush()
    if not (child := os.fork()):
        importlib.import_module(name)
        threads = len(os.listdir("/proc/self/task"))
        print(json.dumps([name, sorted(sys.modules), threads]), flush=True)
        os._exit(0)
    os.waitpid(child, 0)
"""


@pytest.fixture(scope="module")
def loaded() -> dict[str, tuple[frozenset[str], int]]:
    """The modules and threads in a node's process once its own module is imported, by node."""
    command = [sys.executable, "-c", _PROGRAM, *NEEDED]
    env = session_environment(0)
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=True, env=env)
    lines = map(json.loads, done.stdout.splitlines())
    return {name: (frozenset(found), threads) for name, found, threads in lines}


@pytest.mark.parametrize("node", NEEDED)
def test_a_node_imports_the_heavy_packages_that_it_needs_and_no_others(
    loaded: dict[str, tuple[frozenset[str], int]], node: str
) -> None:
    assert loaded[node][0] & HEAVY == NEEDED[node]


@pytest.mark.parametrize("node", NEEDED)
def test_importing_a_node_starts_no_thread(
    loaded: dict[str, tuple[frozenset[str], int]], node: str
) -> None:
    """Another node is forked from the process that imported it."""
    assert loaded[node][1] == 1
