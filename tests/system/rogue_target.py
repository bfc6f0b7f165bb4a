"""An object target that calls itself by another name from some time on; started by a test."""

from __future__ import annotations

from dataclasses import replace

from ssp_core.clock import seconds_to_ns
from ssp_core.motion.state import ObjectState
from ssp_ot_controller.ros import object_target

CHANGE_NS = seconds_to_ns(8.0)
_honest = object_target.encode_state


def _disguised(state: ObjectState) -> bytes:
    if state.stamp_ns >= CHANGE_NS:
        state = replace(state, object_id="ot7")
    return _honest(state)


def main() -> None:
    object_target.encode_state = _disguised
    object_target.main()
