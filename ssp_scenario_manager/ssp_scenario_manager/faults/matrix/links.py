"""Rows of the link to an object: delay, loss, reordering."""

from __future__ import annotations

from ssp_scenario_manager.faults.matrix.common import (
    ABORTED,
    HARNESS,
    SEEN_S,
    VALID,
    same,
    stages,
    valid,
)
from ssp_scenario_manager.faults.model import OT, Cell, Expected, Row, Stage, Within


def _delayed(milliseconds: int, cells: dict[Stage, Cell]) -> Row:
    return Row(
        f"link_delay_{milliseconds}",
        f"Link delay {milliseconds} ms each way",
        "link_delay",
        target=OT,
        value=milliseconds / 1000.0,
        cells=cells,
    )


def _lossy(percent: int, cells: dict[Stage, Cell]) -> Row:
    return Row(
        f"link_loss_{percent}",
        f"Link loss {percent} % each way",
        "link_loss",
        target=OT,
        value=percent / 100.0,
        cells=cells,
    )


def _late(why: str, primary: tuple[str, ...], later: str) -> dict[Stage, Cell]:
    """A link that is too slow for the manoeuvre's reference, and good enough for all else."""
    refused = Expected(
        ABORTED,
        why,
        by="the object by itself, then the manager",
        primary=primary,
        also=("reference_refused", "ack_missing", "object_aborted"),
        since="abort",
    )
    well = valid(later)
    return {
        Stage.ARMED: refused,
        Stage.BEFORE: refused,
        Stage.AFTER: well,
        Stage.CONFLICT: well,
    }


_SILENT = Expected(
    ABORTED,
    "States and heartbeats stay away for 0.5 s at once: the manager misses the object's states "
    "after 0.3 s and aborts; the object hears that late, but misses the heartbeats by itself.",
    by="the manager, and the object by itself",
    primary=("object_silent", "heartbeat_lost"),
    also=(
        "heartbeat_lost",
        "object_silent",
        "ack_missing",
        "reply_missing",
        "link_delay",
        "reference_refused",
    ),
    within=Within(SEEN_S, "state_age_s"),
    blind=Within(SEEN_S, "heartbeat_s"),
)
DELAYS = [
    _delayed(
        50,
        same(valid("Well inside all limits; references are sent early enough for it.")),
    ),
    _delayed(
        150,
        _late(
            "A reference is sent lead_time_s before it is to be executed, 0.1 s unless the event "
            "says more, and comes 0.15 s later: too late, it is refused and the object stops. That "
            "is the stated limit; a slower link needs a longer lead_time_s.",
            ("reference_refused",),
            "Half of the age that a state may have; nothing is on its way any more.",
        ),
    ),
    _delayed(
        225,
        _late(
            "As with 150 ms. There and back it takes 0.45 s and two steps, and ack_s is 0.5 s, so "
            "that the answer to a reference may be missed before.",
            ("reference_refused", "ack_missing"),
            "States are 0.245 s old at most, limit 0.3 s; there and back 0.45 s of 0.5.",
        ),
    ),
    _delayed(
        500,
        stages(
            Expected(
                ABORTED | HARNESS,
                "There and back takes a second, and the site allows half of one: the measured "
                "link keeps the session from starting.",
                by="the manager",
                primary=("the link to",),
                also=("no answer",),
                starts=False,
            ),
            _SILENT,
        ),
    ),
]
_HALF = Expected(
    VALID | ABORTED,
    "States and heartbeats come often enough to bear it. But every second reference is lost the "
    "first time, and sent again it may come too late to be executed in time: then it is refused "
    "and everything stops. While armed there are only 20 heartbeats a second, and ten in a row are "
    "lost every other minute. Which of it happens is a matter of the seed; both are right.",
    by="the object by itself, or nobody",
    primary=("reference_refused", "ack_missing", "heartbeat_lost", "object_silent"),
    also=("reference_refused", "ack_missing", "heartbeat_lost", "object_aborted"),
    since="abort",
)
LOSSES = [
    _lossy(5, same(valid("States come every 20 ms; a lost reference is sent again."))),
    _lossy(20, same(valid("Three in a row are lost once in 125; references are sent again."))),
    _lossy(
        50,
        {
            Stage.ARMED: _HALF,
            Stage.BEFORE: _HALF,
            Stage.AFTER: valid("Fifteen states in a row are lost once in 32768."),
            Stage.CONFLICT: valid("Fifteen states in a row are lost once in 32768."),
        },
    ),
]
REORDERED = Row(
    "link_reorder",
    "Reordering: 30 % of the states overtaken",
    "link_reorder",
    target=OT,
    value=0.3,
    cells=same(valid("An older state than the newest one known is dropped, by its stamp.")),
)
