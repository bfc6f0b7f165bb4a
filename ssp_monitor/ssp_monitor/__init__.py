"""Recorder, live status and bag tools of SSP.

Its public API is what ``PUBLIC`` names; docs/api.md describes it.
"""

from typing import Any

from ssp_core.public_names import public_name

# Loaded when they are asked for, so that a node or command pays for what it uses alone.
PUBLIC = {
    "summarise_bag": "ssp_monitor.bag_tools.info",
}


def __getattr__(name: str) -> Any:
    return public_name(__name__, PUBLIC, name)
