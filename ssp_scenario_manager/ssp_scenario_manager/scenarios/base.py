"""The self-description of one kind of interaction: facts for the checks, a plan for the compiler.

A further kind is one module with one ``Kind`` and one plan function, and a line in ``KINDS``;
docs/adding-an-event.md says what else knows of kinds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

from ssp_core.motion.encounter import Observable
from ssp_core.run_file.model import EndCondition, Limits
from ssp_core.run_file.participants import Brake, GiveWay, Hold, LaneChange
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.maps.block import Block

Relation = Literal["merge", "crossing", "following"]


@dataclass(frozen=True, slots=True)
class BlockPoint:
    """A place in a block's frame: arc length and offset (+ left), m."""

    s_m: float
    l_m: float


@dataclass(frozen=True, slots=True)
class Drive:
    """A drive along the block at an offset: start, cruise speed, and where to stand.

    An end before the start is a drive in the opposite direction. ``headway_s``, what its driver
    keeps to somebody ahead, and ``gives_way`` are the VUT's alone.
    """

    start: BlockPoint
    cruise_mps: float
    end_s_m: float
    acceleration_mps2: float = 2.0
    deceleration_mps2: float = 2.0
    headway_s: float = 1.4
    gives_way: GiveWay | None = None

    @property
    def heading_rad(self) -> float:
        """Heading relative to the block, + left."""
        return 0.0 if self.end_s_m >= self.start.s_m else math.pi


@dataclass(frozen=True, slots=True)
class Wait:
    """Standing, until the trigger or for good; heading relative to the block, + left."""

    start: BlockPoint
    heading_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class Cross:
    """A way to another place: straight, or over further places in between."""

    goal: BlockPoint
    speed_mps: float
    acceleration_mps2: float
    via: tuple[BlockPoint, ...] = ()


Act = LaneChange | Cross | Brake | Hold


@dataclass(frozen=True, slots=True)
class Trigger:
    """The condition that fires an act of the initiator.

    Args:
        object_id: the initiator, that a distance is measured to, and that acts.
        quantity: what is compared.
        below: m for relative_distance, s for time_to_arrival (at ``anchor``).
        anchor: on the VUT's path; None for relative_distance.
        act: what it does.
        lead_time_s: between dispatch and act.
        not_before_s: session time before which nothing fires.
        actor_id: another object that acts instead; None: the initiator does.
    """

    object_id: str
    quantity: Literal["relative_distance", "time_to_arrival"]
    below: float
    anchor: BlockPoint | None
    act: Act
    lead_time_s: float = 0.1
    not_before_s: float = 0.0
    actor_id: str | None = None

    @property
    def acting_id(self) -> str:
        """Id of the object that acts."""
        return self.actor_id or self.object_id


@dataclass(frozen=True)
class Plan:
    """An event on a block, in the block's frame (METHOD 2.3).

    Args:
        vut: how the VUT drives; its driver reacts by itself.
        targets: what each OT does before the trigger, by id, occluders included.
        trigger: of the initiator.
        conflict: the conflict point (METHOD 1).
        zone: corners of the conflict zone, in order.
        expected: the VUT's reference point when the trigger fires, as foreseen.
        choices: values that were chosen within part C, by field path: (value, unit, why).
        at_most: the place's upper limits of such values, by field path; none where it has none.
        gap_s: time gap at the conflict point if the VUT keeps its speed; None: there is none.
    """

    vut: Drive
    targets: Mapping[str, Drive | Wait]
    trigger: Trigger
    conflict: BlockPoint
    zone: tuple[BlockPoint, ...]
    expected: BlockPoint
    choices: Mapping[str, tuple[float, str, str]]
    at_most: Mapping[str, float] = field(default_factory=dict)
    gap_s: float | None = None


@dataclass(frozen=True)
class Setting:
    """An event that is to be placed on a block.

    Args:
        limits: Ω_safe, by place and K*.
        preferred: speeds and gaps that are tried first, by field path: what a person prefers or,
            for the track, what was validated in simulation.
        routes: through the junctions of the place, by their ids.
    """

    event: Event
    block: Block
    limits: Limits
    preferred: Mapping[str, float]
    routes: Mapping[str, Block] = field(default_factory=dict)


class CannotPlace(Exception):
    """The event doesn't fit this block; the message is the reason, for people."""


@dataclass(frozen=True)
class Kind:
    """One kind of interaction.

    Args:
        observable: what starts the trigger phase (METHOD 1).
        dominant_motions: classes that its dominant motion may have.
        initiator_classes: object classes that the initiator may have.
        initiator_places: places (event_spec.model.Region.place) that the initiator may start from,
            per dominant motion.
        first: who may reach the conflict point first.
        manoeuvre: names and units that ``constraints.manoeuvre`` must hold.
        trigger_quantities: that ``constraints.trigger.quantity`` may be.
        needs_occluder: ``interaction.occluder`` must name an OT; it stands, unless it leaves.
        uses_arrival_gap: arrivals at the zone are compared; else TTC alone makes the conflict.
        same_direction_lanes: that the road must at least have.
        manoeuvres: that the road must permit.
        plans: ways to place the event, from what is preferred on. Raises CannotPlace where there
            is none.
        at_junction: it takes place on routes through a junction, and nowhere else.
        turn: headings of its initiator, in words of part M, before and after it turns; None: it
            doesn't.
        vut_intents: what the VUT may mean to do.
        turns_left: the VUT's route turns left, though the VUT keeps its lane around a ring.
        after_resolution_s: time for which a session goes on after its resolution.
    """

    name: str
    relation: Relation
    zone: Literal["vut_lane", "corridor_crossing"]
    observable: Observable
    dominant_motions: frozenset[str]
    initiator_classes: frozenset[str]
    initiator_places: Mapping[str, frozenset[str]]
    first: Literal["initiator", "affected", "either"]
    manoeuvre: Mapping[str, str]
    trigger_quantities: frozenset[str]
    needs_occluder: bool
    uses_arrival_gap: bool
    same_direction_lanes: int
    manoeuvres: Callable[[Event], frozenset[str]]
    plans: Callable[[Setting], Iterator[Plan]]
    at_junction: bool = False
    occluder_leaves: bool = False
    turn: tuple[str, str] | None = None
    vut_intents: frozenset[str] = frozenset({"keep_lane"})
    turns_left: bool = False
    after_resolution_s: float = EndCondition().after_resolution_s
