"""The bag of a run whose event came as it was compiled."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ssp_core.run_file.model import load_run
from tests.support.bags.messages import messages


def check_event(folder: Path, result: dict[str, Any]) -> None:
    """Assert that the event of a run came as it was compiled.

    Args:
        folder: of the run.
        result: its result.json.
    """
    assert (result["verdict"], result["reasons"]) == ("valid", [])
    bag = folder / "bag"
    phases = [m.phase for m in messages(bag, "/ssp/phase_event")]
    assert phases == [1, 2, 3, 4]
    (trigger,) = messages(bag, "/ssp/trigger_event")
    stamp_ns = trigger.crossing_time.sec * 10**9 + trigger.crossing_time.nanosec
    low, high = (t.sec * 10**9 + t.nanosec for t in trigger.sample_stamps)
    assert low <= stamp_ns <= high
    acks = messages(bag, "/ssp/ot1/reference_ack")
    assert acks
    assert all(a.accepted for a in acks)
    assert {a.reference_id for a in acks} >= set(trigger.reference_ids)
    tracked = [m for m in messages(bag, "/ssp/ot1/state") if m.reference_id]
    assert max(abs(m.error_lateral) for m in tracked) < 0.3
    assert not messages(bag, "/ssp/safety_event")

    measured = result["measured"]
    (fired,) = measured["triggers"]
    (sent,) = fired["references"]
    way = [fired["crossing_s"], fired["judged_s"], fired["dispatched_s"]]
    way += [sent["acknowledged_s"], sent["execute_at_s"], sent["onset"]["at_s"]]
    assert way == sorted(way)
    assert way[-1] - way[-2] < 0.2
    assert measured["tracking"]["ot1"]["lateral_rms_m"] <= 0.05
    assert measured["tracking"]["ot1"]["longitudinal_rms_m"] <= 0.10
    run = load_run(folder / "run.yaml")
    states = measured["states"]
    assert states.keys() == {"vut", *(target.id for target in run.targets)}
    for name in states:
        # Nothing is lost but what the site's links lose.
        most = 3.0 * run.disturbance_of(name).state_loss * states[name]["received"]
        assert states[name]["lost"] <= most
