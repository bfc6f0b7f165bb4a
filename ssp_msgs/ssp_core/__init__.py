"""The small library that every SSP package shares; it imports without ROS.

Its public API is what ``PUBLIC`` names; docs/api.md describes it.
"""

import sys
from typing import Any

from ssp_core.compiled import use_compiled
from ssp_core.cycles import put_search_off
from ssp_core.public_names import public_name

__version__ = "0.1.0"

# Of the rules by which imports are checked, answers are read and domains are shown. Cells and
# imports hold it. It is raised where what was made before may come out otherwise, see
# docs/updating.md.
RULES_VERSION = 2

# Loaded when they are asked for, so that a node or command pays for what it uses alone.
PUBLIC = {
    "BagReader": "ssp_core.bag.reading.reader",
    "BagWriter": "ssp_core.bag.writing.writer",
    "InputError": "ssp_core.errors",
    "ObjectState": "ssp_core.motion.state",
    "RunSpec": "ssp_core.run_file.model",
    "SspError": "ssp_core.errors",
    "check_bag": "ssp_core.bag.operations.check",
    "load_run": "ssp_core.run_file.model",
}

# Python names a program so while it looks for the module of ``python -m``.
if sys.argv[:1] == ["-m"]:
    put_search_off()
use_compiled()


def __getattr__(name: str) -> Any:
    return public_name(__name__, PUBLIC, name)
