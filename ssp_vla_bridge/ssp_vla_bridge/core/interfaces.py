"""The native interfaces of the systems: what each is asked with, and how its answers are read.

Facts of VLA_FORMATS. A backend speaks an interface; the evaluator builds requests for it, and the
adapter of the same name reads what comes back.
"""

from __future__ import annotations

from dataclasses import dataclass

from ssp_core.errors import InputError
from ssp_vla_bridge.core.window import Preprocessing


@dataclass(frozen=True)
class Interface:
    """What a family of models expects and gives.

    Args:
        name: as in options and results.
        adapter: that reads its answers, ``name`` or ``name:mode``.
        preprocessing: which frames and ego samples it is given.
        carries_previous: its request holds the model's own last answer about the same clip.
    """

    name: str
    adapter: str
    preprocessing: Preprocessing
    carries_previous: bool = False


_ALL = (
    Interface("waypoints", "waypoints", Preprocessing()),
    # One frame; ten steps of 0.5 s, which need eleven samples.
    Interface(
        "openemma",
        "openemma:corrected",
        Preprocessing(frames=1, history_s=5.0, history_spacing_s=0.5),
        carries_previous=True,
    ),
    # Six steps of 0.5 s, and the pose before for the first one's curvature.
    Interface(
        "lightemma",
        "lightemma",
        Preprocessing(frames=1, history_s=3.5, history_spacing_s=0.5),
    ),
    Interface(
        "llavida",
        "llavida",
        Preprocessing(frames=1, history_s=3.0, history_spacing_s=0.5),
    ),
    # Four frames and sixteen poses at 10 Hz, the last pose being the origin.
    Interface(
        "alpamayo",
        "alpamayo",
        Preprocessing(frames=4, frame_spacing_s=0.1, history_s=1.5, history_spacing_s=0.1),
    ),
)
INTERFACES: dict[str, Interface] = {one.name: one for one in _ALL}


def find_interface(name: str) -> Interface:
    """The interface of that name.

    Raises:
        InputError: there is none.
    """
    if name not in INTERFACES:
        raise InputError(
            "unknown interface",
            field="interface",
            value=name,
            remedy=f"known are {', '.join(sorted(INTERFACES))}",
        )
    return INTERFACES[name]
