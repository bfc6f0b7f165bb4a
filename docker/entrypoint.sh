#!/usr/bin/env bash
set -e
source /opt/ros/jazzy/setup.bash
source /ssp/install/setup.bash
# The virtual environment's packages, for programs that ROS starts with the system's Python.
export PYTHONPATH="$(echo /opt/ssp/lib/python3*/site-packages):$PYTHONPATH"
exec "$@"
