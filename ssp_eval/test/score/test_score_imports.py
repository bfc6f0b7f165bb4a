"""Scoring must run where there is no ROS, no OpenCV and no plotting."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

import ssp_eval.score

# rosidl and launch stand for what comes with ROS under other names.
NEVER = (
    "rclpy",
    "ssp_msgs",
    "rosidl_runtime_py",
    "launch",
    "rosbags",
    "cv2",
    "matplotlib",
    "plotly",
    "scipy",
    "pandas",
    "numba",
    "libsumo",
    "av",
    "aiohttp",
)
MODULES = sorted(path.stem for path in Path(ssp_eval.score.__file__).parent.glob("[a-z]*.py"))


def test_the_modules_are_found():
    assert {"cell", "engine", "matching"} < set(MODULES)


@pytest.mark.parametrize("module", ["", *MODULES])
def test_importing_it_pulls_in_nothing_heavy(module):
    name = f"ssp_eval.score.{module}".rstrip(".")
    code = f"import {name}, json, sys; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=600, check=True
    )
    loaded = {name.split(".")[0] for name in json.loads(done.stdout)}
    assert loaded.isdisjoint(NEVER)
