"""The parts of a session in one process that packages above ssp_core provide.

Manager, controller and monitor never import each other, and a session without a model needs no
ssp_eval. What one of them takes from another has its interface in ssp_core, and its module here.
"""

from __future__ import annotations

import importlib
from enum import Enum
from typing import Any


class Provider(Enum):
    """A provider's module, loaded when it is first wanted."""

    PLANT = "ssp_ot_controller.in_process"  # make_plant, make_camera: see plant.py
    RECORDER = "ssp_monitor.in_process"  # make_recorder: see recorder.py
    BASELINES = "ssp_ot_controller.driving.baselines"  # drivers of ours: see driver.py
    MODELS = "ssp_eval.evaluate.driving"  # models behind bridges: see driver.py
    DRIVING_FACTS = "ssp_ot_controller.driving.facts"  # driving_facts, for the cards of drivers

    def load(self) -> Any:
        """Return the module."""
        return importlib.import_module(self.value)
