"""Scoring must run where there is no ROS, no OpenCV and no plotting."""

import json
import subprocess
import sys

import pytest

HEAVY = ("rclpy", "ssp_msgs", "cv2", "matplotlib", "scipy", "numpy", "libsumo", "numba", "rosbags")


@pytest.mark.parametrize(
    "module", ["ssp_eval.score", "ssp_eval.score.cli", "ssp_eval.score.aggregate"]
)
def test_importing_it_pulls_in_nothing_heavy(module):
    code = f"import {module}, json, sys; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True
    )
    loaded = {name.split(".")[0] for name in json.loads(done.stdout)}
    assert loaded.isdisjoint(HEAVY)
