"""The node ``evaluator``: evaluates with bridges that run already, set by ROS parameters."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import NoReturn

import rclpy
from rclpy.utilities import remove_ros_args

from ssp_core.console import report_error
from ssp_core.errors import SspError
from ssp_core.host.terminal import end_at_once
from ssp_core.ros import declare, init, make_node
from ssp_eval.evaluate.cli import driving_before
from ssp_eval.evaluate.clients.models import as_attached, attached_spec, load_models
from ssp_eval.evaluate.conditions.expansion import with_controls, with_pictures
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.executors import Settings
from ssp_eval.evaluate.ros.model_node import NAME
from ssp_eval.evaluate.run import evaluate_bags
from ssp_eval.ros.parameters import EVALUATOR


def main() -> NoReturn:
    """Evaluate bags with bridges that run already: ``ros2 run ssp_eval evaluator``."""
    end_at_once(_status())


def _status() -> int:
    if len(remove_ros_args(sys.argv)) > 1:
        report_error("takes ROS parameters only: --ros-args -p bags:=[...] -p models:=[...]")
        return 2
    try:
        init(sys.argv)
        return _evaluate()
    except SspError as error:
        report_error(str(error))
        return 1
    finally:
        rclpy.try_shutdown()


def _evaluate() -> int:
    settings = make_node(f"{NAME}_settings")
    parameters = declare(settings, EVALUATOR)
    settings.destroy_node()
    out, models_file = Path(parameters["out"]), parameters["models_file"]
    specs = as_attached(load_models(Path(models_file))) if models_file else []
    specs += [attached_spec(name) for name in parameters["models"] if name]
    if specs and parameters["controls"]:
        specs = with_controls(specs, driving_before(out))
    results = evaluate_bags(
        [(Path(bag), None) for bag in parameters["bags"] if bag],
        with_pictures(specs) if parameters["pictures"] else specs,
        Settings(
            out,
            options=CellOptions(
                adapter=parameters["adapter"], retry_errors=parameters["retry_errors"]
            ),
            timeout_s=parameters["timeout_s"],
            start_timeout_s=parameters["start_timeout_s"],
        ),
        no_controls="-p controls:=false",
        twins=parameters["twins"],
    )
    for result in results:
        print(f"{result.folder.name}: {result.status} {'; '.join(result.reasons)}".rstrip())
    return 0 if results and not any(result.is_failure for result in results) else 1


if __name__ == "__main__":
    main()
