"""The modules that the nodes of a session are started from."""

from __future__ import annotations

import subprocess
import sys

from ssp_core.host.environment import session_environment
from ssp_scenario_manager.run.over_dds.session import NODE_MODULES

THREADS = """
import importlib
import os
import sys

for module in ("rclpy", *sys.argv[1:]):
    importlib.import_module(module)
    print(len(os.listdir("/proc/self/task")))
"""


def test_modules_of_nodes_start_no_thread_beside_those_of_rclpy() -> None:
    """Nodes are forked, and a lock that a thread held at the fork would be held for ever."""
    command = [sys.executable, "-c", THREADS, *NODE_MODULES.values()]
    env = session_environment(199)
    counts = subprocess.run(command, env=env, capture_output=True, text=True, check=True).stdout
    with_rclpy, *with_nodes = counts.split()
    assert with_nodes == [with_rclpy] * len(NODE_MODULES)
