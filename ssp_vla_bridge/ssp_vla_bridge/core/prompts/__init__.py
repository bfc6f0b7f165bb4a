"""The systems' own prompts, all made from the one DrivingTask (METHOD 5.1), by interface.

What an interface asks, in which steps and in which units are facts of the system's repository
(VLA_FORMATS); the sentences are ours, and the words of the task are the task's.
"""

from __future__ import annotations

from ssp_core.errors import InputError
from ssp_vla_bridge.core.prompts.lightemma import LIGHTEMMA
from ssp_vla_bridge.core.prompts.llavida import LLAVIDA
from ssp_vla_bridge.core.prompts.openemma import OPENEMMA
from ssp_vla_bridge.core.prompts.types import Prompt, Stage
from ssp_vla_bridge.core.prompts.waypoints import WAYPOINTS

__all__ = ["PROMPTS", "Prompt", "Stage", "find_stages"]

PROMPTS: dict[str, tuple[Stage, ...]] = {
    "openemma": OPENEMMA,
    "lightemma": LIGHTEMMA,
    "llavida": LLAVIDA,
    "waypoints": WAYPOINTS,
}


def find_stages(interface: str) -> tuple[Stage, ...]:
    """The steps in which an interface asks, first to last.

    Raises:
        InputError: there is no prompt for this interface.
    """
    if interface not in PROMPTS:
        raise InputError(
            "has no prompt",
            field="backend_options.interface",
            value=interface,
            remedy=f"known are {', '.join(sorted(PROMPTS))}",
        )
    return PROMPTS[interface]
