"""Conflict timing in whole sessions: a few runs of the study, and links that are slow or lossy."""

from __future__ import annotations

from typing import Any

import pytest

from ssp_core.motion.reference import Reference
from ssp_core.run_file.model import LinkDisturbance, RunSpec
from ssp_core.vocabulary import Verdict
from ssp_scenario_manager.run.in_process import run_in_process
from ssp_scenario_manager.run.in_process_session import InProcessSession
from ssp_scenario_manager.session import outbox
from tests.support.events.adaptation import (
    NOISE,
    TOLERANCE_S,
    Case,
    Scenario,
    case_of,
    measure_case,
    run_of,
    specified_gap_s,
)

# Seeds whose VUT is far enough off to tell with from without.
SEEDS: dict[Scenario, tuple[int, int]] = {"cut_in": (4, 8), "vru_crossing": (0, 3)}


@pytest.mark.parametrize("scenario", SEEDS)
def test_the_time_gap_holds_with_adaptation_and_does_not_without(scenario: Scenario) -> None:
    gap_s = specified_gap_s(scenario)
    adapted = [measure_case(scenario, gap_s, True, seed) for seed in SEEDS[scenario]]
    fixed = [measure_case(scenario, gap_s, False, seed) for seed in SEEDS[scenario]]
    assert [r.verdict for r in adapted] == ["valid"] * len(adapted)
    assert all(r.right_order for r in adapted)
    assert max(abs(r.error_s) for r in adapted) <= TOLERANCE_S
    assert max(abs(r.error_s) for r in fixed) > TOLERANCE_S
    assert all(r.adapted > 0 for r in adapted)
    assert all(r.adapted == 0 for r in fixed)


def with_links(wish: dict[str, Any], links: LinkDisturbance) -> RunSpec:
    """A crossing whose VUT is too slow, adapted as wished, over disturbed links of the OT."""
    run = run_of("vru_crossing", Case(1, 0.85, 0.95, 0.5), 1.0, LinkDisturbance())
    trigger = run.triggers[0]
    assert trigger.adaptation is not None
    adaptation = trigger.adaptation.model_copy(update=wish)
    return run.model_copy(
        update={
            "disturbances": {"ot1": links},
            "triggers": [trigger.model_copy(update={"adaptation": adaptation})],
        }
    )


@pytest.mark.parametrize(
    ("links", "lead_s"),
    [
        (LinkDisturbance(command_delay_s=0.06, state_delay_s=0.06), 0.1),
        (LinkDisturbance(command_delay_s=0.14, state_delay_s=0.06), 0.2),
        (LinkDisturbance(command_loss=0.3, state_loss=0.3), 0.2),
    ],
)
def test_slow_and_lossy_links_end_no_run_at_twenty_hertz(
    links: LinkDisturbance, lead_s: float
) -> None:
    wish = {"rate_hz": 20.0, "dead_band_s": 0.0, "lead_time_s": lead_s}
    run = with_links(wish, links)
    trigger = run.triggers[0].model_copy(update={"lead_time_s": 0.4})
    result, _ = run_in_process(run.model_copy(update={"triggers": [trigger]}))
    assert (result.verdict, result.reasons) == (Verdict.VALID, ())
    assert result.passing.other_first is True
    assert result.passing.time_gap_s == pytest.approx(1.0, abs=0.15)


def test_a_link_that_is_too_slow_ends_the_adaptation_and_not_the_run() -> None:
    """Adapted references come too late whatever their lead; the manoeuvre itself doesn't."""
    from ssp_core.world.plant import make_plant

    wish = {"lead_time_s": 0.02, "rate_hz": 20.0}
    links = LinkDisturbance(command_delay_s=0.42, state_delay_s=0.02)
    run = with_links(wish, links)
    trigger = run.triggers[0].model_copy(update={"lead_time_s": 0.6})
    limits = run.limits.model_copy(update={"ack_s": 1.0, "heartbeat_s": 1.0})
    run = run.model_copy(update={"triggers": [trigger], "limits": limits})
    plant = make_plant(run)
    try:
        session = InProcessSession(run, plant)
        session.run()
    finally:
        plant.close()
    assert (session.session.verdict, session.session.reasons) == (Verdict.VALID, ())
    notes = [note.text for note in session.of_kind(outbox.Note)]
    assert any("adaptation ends" in note and "was refused" in note for note in notes)
    assert sum(r.purpose == "adapted" for r in session.of_kind(Reference)) < 40


def test_the_adapted_references_are_the_same_in_every_run() -> None:
    gap_s = specified_gap_s("vru_crossing")
    run = run_of("vru_crossing", case_of(3), gap_s, NOISE)
    first, second = run_in_process(run)[1], run_in_process(run)[1]
    assert first.arrived("ot1") == second.arrived("ot1")
    assert any(s.reference_id == "ot1-3" for s in first.arrived("ot1"))
