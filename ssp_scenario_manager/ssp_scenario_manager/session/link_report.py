"""What is known of the links of a session, for operators and for the record (LinkStatus.msg)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ssp_core.clock import ns_to_seconds
from ssp_scenario_manager.session.link_quality import LinkClocks, LossCounter, LossCounters
from ssp_scenario_manager.session.session import Session


@dataclass(frozen=True, slots=True)
class LinkLine:
    """One object's link; fields as in LinkStatus.msg, NaN for what isn't known."""

    object_id: str
    offset_s: float
    delay_s: float
    state_age_s: float
    received: int
    lost: int


def link_report(
    session: Session,
    links: LinkClocks,
    losses: LossCounters,
    now_ns: int,
    steady_ns: int,
) -> list[LinkLine]:
    """One line per object of the run, the VUT first; none before one is loaded.

    Args:
        session: gives the newest states.
        links: the answers to heartbeats.
        losses: states counted.
        now_ns: session time.
        steady_ns: now, on the steady clock.
    """
    spec = session.spec
    if spec is None:
        return []
    states = {**session.targets, spec.vut.id: session.vut}
    lines = []
    for object_id in (spec.vut.id, *(target.id for target in spec.targets)):
        link = links.link(object_id, steady_ns)
        state = states.get(object_id)
        age_s = math.nan if state is None else ns_to_seconds(now_ns - state.stamp_ns)
        count = losses.of.get(object_id, LossCounter())
        lines.append(
            LinkLine(object_id, link.offset_s, link.delay_s, age_s, count.received, count.lost)
        )
    return lines
