"""Retrieval: how well each block suits an event (METHOD 2.2).

    total(b) = λ_T S_T(K*, b) + λ_I S_I(K*, b) + λ_C S_C(K*, b),    λ_T = λ_I = λ_C = 1/3

Each S is the mean of the shares in [0, 1] to which the needs of its part are met:

    S_T  road type; segment; lanes in the VUT's direction; oncoming lanes; a lane for the VUT;
         left boundary; right boundary
    S_I  a conflict area of the relation; manoeuvres permitted; places of the participants
    S_C  length; speed limit; lane width; curvature; clearance beside the road

`needs` has each share's formula, and says which needs exclude a block that doesn't meet them. A
block is eligible when no such need is unmet and it differs from K* in no identity field. Nothing
here looks at who asks or in which order, so equal blocks get equal scores; ties are for a person.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ssp_scenario_manager.compile.task import BlockScore
from ssp_scenario_manager.interactions import KINDS
from ssp_scenario_manager.interactions.base import Kind
from ssp_scenario_manager.spec.model import Event
from ssp_scenario_manager.topology import needs
from ssp_scenario_manager.topology.block import Block, Library
from ssp_scenario_manager.topology.needs import Met


@dataclass(frozen=True, slots=True)
class RetrievalWeights:
    """λ of METHOD 2.2, fixed before any model is evaluated, and when two totals are a tie."""

    topology: float = 1 / 3
    interaction: float = 1 / 3
    constraints: float = 1 / 3
    tie: float = 1e-9


WEIGHTS = RetrievalWeights()


def _mean(met: Sequence[Met]) -> float:
    return min(1.0, sum(one.share for one in met) / len(met))


def score_block(event: Event, block: Block, kind: Kind) -> BlockScore:
    """METHOD 2.2 for one block; its reasons name each need that excludes it, with numbers."""
    t = event.topology
    # Topology first, and of it the number of lanes: what a map can't change.
    topology = {
        "lanes_same_direction": needs.same_direction(event, block, kind),
        "road_type": needs.road_type(event, block),
        "segment": needs.segment(event, block),
        "lanes_opposite": needs.opposite(event, block),
        "vut_lane": needs.vut_lane(event, block),
        "left_boundary": needs.boundary(t.left_boundary, block.left_boundary),
        "right_boundary": needs.boundary(t.right_boundary, block.right_boundary),
    }
    interaction = [
        needs.relation(event, block),
        needs.manoeuvres(event, block, kind),
        needs.places(event, block),
    ]
    constraints = [
        needs.length(event, block),
        needs.speed_limit(event, block),
        needs.lane_width(event, block, kind),
        needs.curvature(event, block),
        needs.clearance(event, block),
    ]
    s_t, s_i, s_c = _mean([*topology.values()]), _mean(interaction), _mean(constraints)
    total = WEIGHTS.topology * s_t + WEIGHTS.interaction * s_i + WEIGHTS.constraints * s_c
    differs = needs.identity(event, block)
    met = {name: one.missing for name, one in topology.items() if one.missing is not None}
    reasons = [f"{why} (identity)" if name in differs else why for name, why in met.items()]
    reasons += [f"{why} (identity)" for name, why in differs.items() if name not in met]
    reasons += [one.missing for one in (*interaction, *constraints) if one.missing is not None]
    return BlockScore(
        block=block.block_id,
        topology=s_t,
        interaction=s_i,
        constraints=s_c,
        total=min(1.0, total),
        reasons=reasons,
        eligible=not reasons,
    )


def score_blocks(event: Event, library: Library, kind: Kind | None = None) -> list[BlockScore]:
    """The scores of all blocks of a library: eligible ones first, best first, then by id.

    Args:
        event: a K* that passed its checks.
        library: of a map or site.
        kind: of the interaction; by default the one that the event names.
    """
    if kind is None:
        kind = KINDS[event.interaction.type]
    scores = [score_block(event, block, kind) for block in library.blocks]
    return sorted(scores, key=lambda score: (not score.eligible, -score.total, score.block))


def ties(scores: Sequence[BlockScore]) -> list[BlockScore]:
    """The eligible blocks whose total is the best one's; a single one is the winner."""
    fits = [score for score in scores if score.eligible]
    best = max((score.total for score in fits), default=0.0)
    return [score for score in fits if best - score.total <= WEIGHTS.tie]
