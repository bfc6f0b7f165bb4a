#!/usr/bin/env bash
set -e
source /ssp/install/setup.bash && source /ssp/.ros-venv/bin/activate
exec "$@"
