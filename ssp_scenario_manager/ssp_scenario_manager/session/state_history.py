"""The states of a run's participants as they arrived, each judged by those before it.

This file owns what is remembered of them: a run begins with an empty memory, and nothing is
forgotten once it has started. Reads no clock.
"""

from __future__ import annotations

import math

from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.consistency import Bounds, ConsistencyWatch
from ssp_core.safety.fence import KnownRoom, box_excess_m, moved_excess_m
from ssp_core.safety.limits import (
    Continuity,
    LimitViolation,
    follow,
    is_standing,
    outside_geofence,
    state_contradicts,
)
from ssp_core.safety.start_heading import StartHeading, start_heading
from ssp_scenario_manager.session.limits import Violation, of_object


class StateHistory:
    """Findings from the states so far of each participant, by id.

    Attributes:
        motion: the stated motion, held against the places.
        headings: of the objects whose heading shows only once they drive.
    """

    def __init__(self, spec: RunSpec) -> None:
        limits = spec.limits
        self._limits = limits
        self._geofence = spec.geofence
        self._continuity: dict[str, Continuity] = {}
        self._rooms: dict[str, KnownRoom] = {}
        self._breaks: list[Violation] = []
        self.motion: dict[str, ConsistencyWatch] = {}
        self.headings: dict[str, StartHeading] = {}
        for one in (spec.vut, *spec.targets):
            self.motion[one.id] = ConsistencyWatch(Bounds.of(one.id, one.cls, limits))
            if (heading := start_heading(one, limits)) is not None:
                self.headings[one.id] = heading

    def see(self, state: ObjectState, *, started: bool) -> None:
        """Judge a state that arrived by those before it.

        Args:
            state: of a participant.
            started: the run has started, so that its objects drive off.
        """
        memory = self._continuity.get(state.object_id, Continuity())
        if not started:
            memory = memory.before_motion(state)
        self._continuity[state.object_id], passed = follow(memory, state, self._limits)
        if memory.before is not None and self._continuity[state.object_id].before is state:
            crossed = self._crossed_fence(memory.before, state)
            passed += [] if crossed is None else [crossed]
        breaks = []
        if passed:
            breaks = [of_object(p, state.object_id, state.stamp_ns) for p in passed]
        watch = self.motion.get(state.object_id)
        if watch is not None and state.is_finite:
            watch.see(state)
            if (contradicts := watch.contradiction) is not None:
                breaks.append(
                    of_object(
                        state_contradicts(watch),
                        state.object_id,
                        state.stamp_ns,
                        contradicts.text,
                    )
                )
            heading = self.headings.get(state.object_id)
            if heading is not None and started:
                turned = heading.see(state, stands=is_standing(state, watch))
                breaks.append(of_object(turned, state.object_id, state.stamp_ns))
        if breaks:
            self._breaks += [violation for violation in breaks if violation is not None]

    def _crossed_fence(self, before: ObjectState, state: ObjectState) -> LimitViolation | None:
        """Find the violation of an object that was outside between two states.

        Each state is judged itself.
        """
        moved_m = math.hypot(state.x_m - before.x_m, state.y_m - before.y_m)
        if self.is_well_inside(state, moved_m):
            return None
        excess_m = moved_excess_m(before.pose, state.box, self._geofence)
        if excess_m > 0.0 and box_excess_m(state.box, self._geofence) > 0.0:
            return None
        return outside_geofence(excess_m)

    def is_well_inside(self, state: ObjectState, moved_m: float = 0.0) -> bool:
        """Tell whether an object is known to be inside the fence, and so was on its way.

        Args:
            state: with finite values.
            moved_m: from where it was before.
        """
        room = self._rooms.get(state.object_id)
        if room is None:
            room = self._rooms[state.object_id] = KnownRoom(self._geofence)
        return room.holds(state.x_m, state.y_m, state.size.reach_m + moved_m)

    @property
    def has_breaks(self) -> bool:
        """Tell whether a state doesn't follow from earlier ones; the next step ends the run."""
        return bool(self._breaks)

    def take_breaks(self) -> list[Violation]:
        """Take out what ``see`` has found since the last call, in an order of its own.

        States of one step arrive in any order; what is decided must not depend on it.
        """
        breaks, self._breaks = self._breaks, []
        return sorted(breaks, key=lambda v: (v.stamp_ns, v.object_id, v.code))
