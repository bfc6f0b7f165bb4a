"""Draws of where participants begin, by the lengths of K* (METHOD 8.1).

Where the initiator drives up to its manoeuvre, each participant ahead that drives moves along the
road. Where it stands there, it may stand at a marking, and the VUT begins earlier or later instead,
with the further participants that drive ahead of it; a vehicle that drives between both begins at
a gap of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

from ssp_core.geometry import Box, Polyline
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.event_spec.fields import Span
from ssp_scenario_manager.event_spec.model import Event, Interval
from ssp_scenario_manager.scenarios.further import further_ids

# Between the rear of a VUT at its start and the beginning of the road.
_BEHIND_M = 1.0


def span_of(quantity: object) -> Span | None:
    """Return a closed interval that leaves something to draw; None where K* gives none."""
    if not isinstance(quantity, Interval):
        return None
    span = quantity.si
    return span if math.isfinite(span.low) and math.isfinite(span.high) else None


@dataclass(frozen=True)
class Places:
    """The places of a run's participants along its road.

    Args:
        run: with a path for the VUT.
    """

    run: RunSpec

    @cached_property
    def line(self) -> ReferenceLine:
        """Reference line of the road."""
        return ReferenceLine.of_road(self.run.road)

    @cached_property
    def path(self) -> Polyline:
        """Path of the VUT."""
        if self.run.vut.approach is None:
            raise ValueError("a driven run without a path for the VUT passed the checks")
        return Polyline(self.run.vut.approach.path)

    def gap_m(self, target: ParticipantSpec) -> float:
        """Return the bumper gap from the VUT to a participant ahead, along the VUT's path."""
        size = target.size
        corners = Box(target.start.pose, size.front_m, size.rear_m, size.width_m).corners()
        vut = self.run.vut
        (own_m, _), *projections = self.path.project_all_beyond(
            [(vut.start.x_m, vut.start.y_m), *corners]
        )
        return min(station for station, _ in projections) - own_m - vut.size.front_m

    def local(self, target: ParticipantSpec) -> tuple[float, float]:
        """Return arc length and offset of a participant's start."""
        return self.line.to_local(target.start.x_m, target.start.y_m)

    def with_moved_start(
        self, one: ParticipantSpec, along_m: float, left_m: float = 0.0
    ) -> ParticipantSpec:
        """Return a participant that begins elsewhere, and keeps the end of its path.

        Args:
            one: the participant.
            along_m: further along the VUT's path.
            left_m: further to the left of the road.
        """
        s_m, offset_m = self.local(one)
        station, beside_m = self.path.project_beyond(*self.line.to_map(s_m, offset_m))
        place = self.path.pose(station + along_m, beside_m)
        to_s_m, _ = self.line.to_local(place.x_m, place.y_m)
        to_s_m, to_offset_m = round(to_s_m, 3), round(offset_m + left_m, 3)
        x_m, y_m = self.line.to_map(to_s_m, to_offset_m)
        turn = one.start.yaw_rad - self.line.pose(s_m).yaw_rad
        yaw_rad = math.remainder(self.line.pose(to_s_m).yaw_rad + turn, math.tau)
        start = one.start.model_copy(update={"x_m": x_m, "y_m": y_m, "yaw_rad": yaw_rad})
        approach = one.approach
        if approach is not None:
            end_s_m, _ = self.line.to_local(*approach.path[-1])
            path = self.line.path(to_s_m, end_s_m, to_offset_m)
            approach = approach.model_copy(update={"path": path})
        return one.model_copy(update={"start": start, "approach": approach})


def with_target(run: RunSpec, target: ParticipantSpec) -> RunSpec:
    """Return the run with one of its targets in another place."""
    targets = [target if one.id == target.id else one for one in run.targets]
    return run.model_copy(update={"targets": targets})


def placed_run(
    run: RunSpec, event: Event, uniform: Callable[[float, float], float]
) -> tuple[RunSpec, dict[str, float]]:
    """Return the run with lengths of its manoeuvre drawn from K*, and these by field of K*.

    They are the gap between who crosses and what hides it, and the offset of one who is slow ahead.

    Args:
        run: as it was compiled.
        event: K*.
        uniform: draws between two bounds.
    """
    needs, lengths_m = event.constraints.manoeuvre, dict[str, float]()
    places, targets = Places(run), {target.id: target for target in run.targets}
    first, occluder = targets[run.initiator_id], targets.get(event.interaction.occluder or "")
    if (span := span_of(needs.get("occluder_gap"))) is not None and occluder is not None:
        near_m = places.local(first)[0] - first.size.width_m / 2.0
        is_m = near_m - places.local(occluder)[0] - occluder.size.front_m
        value = round(uniform(span.low, span.high), 3)
        lengths_m["constraints.manoeuvre.occluder_gap"] = value
        run = with_target(run, places.with_moved_start(occluder, is_m - value))
    if (span := span_of(needs.get("offset"))) is not None:
        is_m = places.local(first)[1] - places.local(run.vut)[1]
        value = round(uniform(span.low, span.high), 3)
        lengths_m["constraints.manoeuvre.offset"] = value
        run = with_target(run, places.with_moved_start(first, 0.0, value - is_m))
    return run, lengths_m


@dataclass(frozen=True)
class GapDraw:
    """The draw of the gaps at the start of one seed.

    Args:
        run: with all else drawn.
        event: K*.
        shares: from 0 to 1, by participant: where its gap lies between the least and the largest.
    """

    run: RunSpec
    event: Event
    shares: Mapping[str, float]

    @cached_property
    def _places(self) -> Places:
        return Places(self.run)

    @cached_property
    def _spans(self) -> dict[str, Span]:
        """Gaps that are drawn, by participant: of those ahead that do as the initiator does."""
        stands = {target.id: target.approach is None for target in self.run.targets}
        spans = {}
        for target_id, is_standing in stands.items():
            who = self.event.participants.get(target_id)
            if who is None or who.region.along != "ahead":
                continue
            span = span_of(who.region.gap)
            if span is not None and is_standing is stands[self.run.initiator_id]:
                spans[target_id] = span
        return spans if self.run.initiator_id in spans else {}

    @cached_property
    def _initiator(self) -> ParticipantSpec:
        return next(one for one in self.run.targets if one.id == self.run.initiator_id)

    @cached_property
    def _beside_the_vut(self) -> list[ParticipantSpec]:
        """Further participants ahead that drive: they begin earlier or later with the VUT."""
        further = further_ids(self.event)
        return [
            target
            for target in self.run.targets
            if target.id in further
            and target.approach is not None
            and self.event.participants[target.id].region.along == "ahead"
        ]

    @cached_property
    def _between(self) -> dict[str, Span]:
        """Gaps to those that drive ahead of the VUT towards an initiator that stands."""
        further, spans = further_ids(self.event), dict[str, Span]()
        for target in self.run.targets:
            who = self.event.participants.get(target.id)
            if who is None or who.region.along != "ahead" or target.id in further:
                continue
            span = span_of(who.region.gap)
            if span is not None and target.approach is not None and self._is_by_vut:
                spans[target.id] = span
        return spans

    def _share_m(self, name: str, span: Span) -> float:
        return span.low + self.shares[name] * (span.high - span.low)

    @property
    def _is_by_vut(self) -> bool:
        return self._initiator.approach is None

    @cached_property
    def bounds_m(self) -> Span | None:
        """Least and largest gap to the initiator by K* and the road; None: none is drawn."""
        if not self._spans:
            return None
        mine = self._spans[self.run.initiator_id]
        if not self._is_by_vut:
            return mine
        # A VUT that begins elsewhere changes all gaps alike.
        gaps = {one.id: self._places.gap_m(one) for one in self.run.targets}
        is_m = gaps[self.run.initiator_id]
        low = max(span.low - gaps[name] + is_m for name, span in self._spans.items())
        high = min(span.high - gaps[name] + is_m for name, span in self._spans.items())
        vut = self.run.vut
        room_m = self._places.local(vut)[0] - vut.size.rear_m - _BEHIND_M
        high = min(high, is_m + max(room_m, 0.0))
        return Span(low, high) if low < high else None

    def with_gap(self, gap_m: float) -> tuple[RunSpec, dict[str, float]]:
        """Return the run with a gap to its initiator, and the gaps by field of K*.

        Args:
            gap_m: to the initiator; those to others are their shares of what K* allows.
        """
        places, run = self._places, self.run
        if self._is_by_vut:
            back_m = gap_m - places.gap_m(self._initiator)
            run = run.model_copy(update={"vut": places.with_moved_start(run.vut, -back_m)})
            for target in self._beside_the_vut:
                run = with_target(run, places.with_moved_start(target, -back_m))
            for name, span in self._between.items():
                target = next(one for one in run.targets if one.id == name)
                along_m = self._share_m(name, span) - places.gap_m(target) - back_m
                run = with_target(run, places.with_moved_start(target, along_m))
        else:
            for name, span in self._spans.items():
                target = next(one for one in run.targets if one.id == name)
                wanted_m = self._share_m(name, span)
                if name == run.initiator_id:
                    wanted_m = gap_m
                run = with_target(
                    run, places.with_moved_start(target, wanted_m - places.gap_m(target))
                )
        after, participant_ids = Places(run), {*self._spans, *self._between}
        gaps = {one.id: after.gap_m(one) for one in run.targets if one.id in participant_ids}
        return run, {f"participants.{k}.region.gap": round(v, 3) for k, v in gaps.items()}

    def draw_m(self, room_m: float) -> float:
        """Return the gap to the initiator.

        Args:
            room_m: by which the largest one is more than the hand-over needs.
        """
        bounds = self.bounds_m
        if bounds is None:
            raise ValueError("no gap is drawn")
        low = max(bounds.low, bounds.high - room_m)
        return low + self.shares[self.run.initiator_id] * (bounds.high - low)
