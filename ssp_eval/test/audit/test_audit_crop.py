"""One clip for audit, labels and evaluation: METHOD 4.1 and 4.2 by hand, and on recordings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from ssp_core.bag.operations.cut import cut_bag
from ssp_core.bag.reading.reader import BagReader
from ssp_core.cdr.messages import peek_stamp_ns
from ssp_core.errors import InputError
from ssp_core.motion.state_series import StateSeries
from ssp_core.vocabulary import ControlState, Verdict
from ssp_eval.audit.evidence.reasons import explain
from ssp_eval.audit.evidence.recording import read_recording
from ssp_eval.audit.examine import Examination, examine
from ssp_eval.data.audit import phase_difference, phase_fraction
from ssp_eval.recordings.event import Window, crop_of, phase_starts, rules_of
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.model import Event

# METHOD 5.2b's worked example: starts of trigger, conflict, resolution.
SYNTHETIC = (3.208, 3.333, 5.5)
SIMULATION = (10.64, 10.96, 12.14)
WINDOW = Window(3.208, 3.5, "the source")
Maker = Callable[..., Path]


def phi(starts: tuple[float, ...], first_s: float, last_s: float) -> dict[str, float]:
    crop = crop_of(first_s, last_s, starts[0], starts[2], WINDOW)
    names = ("trigger", "conflict", "resolution")
    return {
        name: phase_fraction(t_s, crop.start_s, crop.end_s)
        for name, t_s in zip(names, starts, strict=True)
    }


# -- by hand ---------------------------------------------------------------------------------------


def test_the_clip_runs_from_the_trigger_minus_a_to_the_resolution_plus_r() -> None:
    crop = crop_of(0.0, 20.0, 10.64, 12.14, WINDOW)
    assert (crop.start_s, crop.end_s) == (pytest.approx(7.432), pytest.approx(15.64))
    assert crop.shortfall == ""
    assert crop.chosen_by == "METHOD 4.1 from the source"
    assert crop.holds(7.432)
    assert not crop.holds(7.43)


def test_phi_differs_only_where_the_event_itself_runs_faster_or_slower() -> None:
    # Simulation: 8.208 s long; (10.64 − 7.432) / 8.208 = 0.39084, 0.42982, 0.57359.
    # Synthetic over 9 s: 0.35644, 0.37033, 0.61111. EPD = (0.03439 + 0.05949 + 0.03752) / 3.
    syn, sim = phi(SYNTHETIC, 0.0, 9.0), phi(SIMULATION, 0.0, 20.0)
    assert sim == pytest.approx(
        {"trigger": 0.390838, "conflict": 0.429825, "resolution": 0.573587}, abs=1e-6
    )
    assert phase_difference(sim, syn) == pytest.approx(0.043802, abs=1e-5)
    # A longer run-up or a later end changes nothing.
    later = tuple(t_s + 31.0 for t_s in SIMULATION)
    assert phi(later, 3.0, 99.0) == pytest.approx(sim)


def test_a_recording_that_is_too_short_is_said_to_be_so() -> None:
    crop = crop_of(8.0, 14.0, 10.64, 12.14, WINDOW)
    assert (crop.start_s, crop.end_s) == (8.0, 14.0)
    assert crop.short_before_s == pytest.approx(0.568)
    assert crop.short_after_s == pytest.approx(1.64)
    assert crop.shortfall == "begins 0.568 s late and ends 1.640 s early"


def test_without_a_trigger_the_clip_is_all_and_without_a_resolution_it_ends_with_it() -> None:
    whole = crop_of(1.0, 14.0, None, None, WINDOW)
    assert (whole.start_s, whole.end_s, whole.shortfall) == (1.0, 14.0, "")
    open_end = crop_of(0.0, 14.0, 10.64, None, WINDOW)
    assert (open_end.start_s, open_end.end_s) == (pytest.approx(7.432), 14.0)
    assert open_end.short_after_s == 0.0
    unknown = crop_of(0.0, 14.0, 10.64, 12.14, None)
    assert (unknown.start_s, unknown.end_s) == (0.0, 14.0)


def test_the_window_of_a_k_star_is_that_of_its_source() -> None:
    window = rules_of(load_event("cut_in")[0]).window
    assert window is not None
    assert (window.before_s, window.after_s) == (pytest.approx(3.208), pytest.approx(3.5))


def test_times_and_thresholds_of_a_k_star_in_ms_are_those_in_s() -> None:
    event, _ = load_event("vru_crossing")
    value = event.model_dump(mode="json", by_alias=True)
    for part in (*value["events"].values(), value["constraints"]["thresholds"]):
        for quantity in part.values():
            if isinstance(quantity, dict):
                assert quantity["unit"] == "s"
                quantity |= {"unit": "ms", "min": _thousandfold(quantity["min"])}
                quantity["max"] = _thousandfold(quantity["max"])
    in_ms = Event.model_validate(value)
    assert phase_starts(in_ms) == pytest.approx(phase_starts(event))
    limits, same = rules_of(in_ms).thresholds, rules_of(event).thresholds
    assert limits.ttc_s == pytest.approx(same.ttc_s)
    assert limits.arrival_gap_s == pytest.approx(same.arrival_gap_s)


def test_a_threshold_that_is_no_time_is_refused() -> None:
    event, _ = load_event("cut_in")
    value = event.model_dump(mode="json", by_alias=True)
    value["constraints"]["thresholds"]["ttc"]["unit"] = "m"
    with pytest.raises(InputError, match=r"is no unit of time.*s or ms"):
        rules_of(Event.model_validate(value))


def _thousandfold(value: float | None) -> float | None:
    return None if value is None else 1000.0 * value


# -- on recordings ---------------------------------------------------------------------------------


@pytest.fixture
def session(make_bag: Maker, make_task: Maker) -> Callable[..., Path]:
    """A compiled cut-in on a road like the K*'s, five seconds after the session's start."""

    def make(name: str, domain: str = "simulation", **options: Any) -> Path:
        task = make_task(f"{name}/task", domain=domain, lanes=2)
        given = {"duration_s": 16.0, "like_k_star": True, "pace": (5.0, 1.0, 1.0, 1.0), **options}
        return make_bag(f"{name}/bag", task=task, **given)

    return make


def look(bag: Path) -> Examination:
    event, version = load_event("cut_in")
    return examine(read_recording(bag), event, version)


def codes(one: Examination) -> Mapping[str, list[str]]:
    return {r.finding.code: [c.code for c in r.consequences] for r in explain(one.findings)}


def test_a_live_session_is_measured_from_the_states_that_were_reported(
    session: Callable[..., Path],
) -> None:
    """Its objects name no control state, so all of them say OFF; they were dropped for that."""
    simulated = look(session("simulated"))
    live = look(session("live", reported=ControlState.OFF))
    assert live.recording.source == "states that VUT and object targets reported"
    assert len(live.recording.series) > 300
    assert live.evidence == "states"
    assert live.properties == simulated.properties
    assert live.phases == simulated.phases
    assert codes(live) == codes(simulated)
    assert not {"epd_missing", "unverified"} & set(codes(live))


def test_an_object_that_was_switched_off_is_followed_until_then(
    session: Callable[..., Path],
) -> None:
    named = look(session("named", reported=ControlState.RUNNING))
    assert named.phases == look(session("live", reported=ControlState.OFF)).phases


def test_a_recording_that_was_cut_to_the_clip_qualifies_like_the_whole_one(
    session: Callable[..., Path], tmp_path: Path
) -> None:
    bag = session("whole")
    whole = look(bag)
    assert whole.crop is not None
    cut, state = tmp_path / "cut" / "bag", "/ssp/vut/state"
    start_ns = whole.recording.provenance.session_start_ns
    assert start_ns is not None
    with BagReader(bag) as reader:
        topics = list(reader.topics)
        # These bags were logged faster than their time passed.
        logged = [
            message.log_time_ns
            for message in reader.messages([state])
            if whole.crop.holds((peek_stamp_ns(message.data) - start_ns) / 1e9)
        ]
    cut_bag(bag, cut, topics, logged[0] - 1_500_000, logged[-1] + 1)
    part = look(cut)
    assert part.recording.provenance.verdict == "valid"
    assert part.recording.provenance.refusal is None
    assert part.properties == whole.properties
    assert part.crop is not None
    assert part.phi == pytest.approx(whole.phi, abs=0.02)
    assert codes(part) == codes(whole)


def test_a_part_keeps_the_verdict_of_the_whole(
    session: Callable[..., Path], tmp_path: Path
) -> None:
    bag = session("aborted", verdict=Verdict.ABORTED, reasons=("the operator aborted",))
    with BagReader(bag) as reader:
        topics, begin_ns = list(reader.topics), reader.start_ns
    assert begin_ns is not None
    cut_bag(bag, tmp_path / "cut" / "bag", topics, begin_ns, begin_ns + 8_000_000_000)
    facts = read_recording(tmp_path / "cut" / "bag").provenance
    assert facts.verdict == "aborted"
    assert "the operator aborted" in (facts.refusal or "")


def test_a_clip_that_is_all_of_its_recording_holds_its_states_once(
    session: Callable[..., Path],
) -> None:
    """An hour of three recordings took 600 MB."""
    one = read_recording(session("simulated"))
    assert one.end_s is not None
    crop = crop_of(0.0, one.end_s, None, None, None)
    whole = one.near(crop)
    assert isinstance(one.series, StateSeries)
    assert isinstance(whole.series, StateSeries)
    assert whole.series._states is one.series._states
    assert whole.sightings is one.sightings
    shorter = one.within(crop_of(1.0, 2.0, None, None, None))
    assert 0 < len(shorter.sightings) < len(one.sightings)


def test_the_states_at_frames_are_made_when_they_are_asked_for(
    session: Callable[..., Path],
) -> None:
    one = read_recording(session("simulated"))
    moments = one.moments()
    assert len(moments) == len(one.frames_s) > 100
    assert [moment.t_s for moment in moments] == list(one.frames_s)
    assert moments[-1] == moments[-2:][1] == list(moments)[-1]
    assert set(moments[50].states) == {"vut", "ot1"}
