"""The silence of one source about another's statement neither admits nor refuses (METHOD 4)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import nan
from pathlib import Path
from typing import Any

import pytest
from observation_files import answers, changed, footage_of, seal

from ssp_eval.audit import examine as examining
from ssp_eval.audit.evidence.evidence import Difference, Evidence, Source, observed_differences
from ssp_eval.audit.evidence.history import examine_history
from ssp_eval.audit.evidence.measure import RoadFacts
from ssp_eval.audit.evidence.recording import Recording, read_recording
from ssp_eval.audit.examine import Examination, examine
from ssp_eval.audit.judge import judge
from ssp_eval.data.audit import ROLES, TOPOLOGY, Property
from ssp_eval.data.provenance import ImportRecord
from ssp_eval.observations.agreement import agree
from ssp_eval.observations.files import load_observation
from ssp_scenario_manager.event_spec.load import event_version, load_event, seal_event

EVENT, VERSION = load_event("cut_in")


@pytest.fixture(scope="module")
def recording(
    tmp_path_factory: pytest.TempPathFactory,
    bag_writer: Callable[..., Path],
    task_writer: Callable[..., Path],
) -> Recording:
    """A session that shows the K*'s event, and more than three seconds after it."""
    root = tmp_path_factory.mktemp("doubt")
    task = task_writer(root / "task", lanes=2)
    return read_recording(bag_writer(root / "bag", task=task, like_k_star=True, duration_s=12.0))


def look(recording: Recording) -> Examination:
    return examine(recording, EVENT, VERSION)


def codes(one: Examination) -> set[str]:
    return {finding.code for finding in one.findings}


@pytest.fixture
def with_observation(recording: Recording, tmp_path: Path) -> Callable[..., Recording]:
    """The recording with what persons saw of it: just that, but for one answer of the first."""

    def make(path: str = "who", value: Any = "Ada Vance", *others: str) -> Recording:
        content, phases = answers(), look(recording).phases
        content["topology"]["lanes_opposite"] = 2
        for name in ("trigger", "conflict", "resolution"):
            t_s = getattr(phases, f"{name}_s")
            content["phases"][name] = {"t_s": t_s, "frames": [40]}
        footage = footage_of(recording.path)
        seen = [changed(path, value, content), *(changed("who", who, content) for who in others)]
        files = [seal(recording.path, tmp_path / f"{k}.json", one) for k, one in enumerate(seen)]
        told = agree([load_observation(file, footage) for file in files], footage.period_s)
        return replace(recording, agreement=told)

    return make


def test_what_is_seen_alike_is_admitted(
    recording: Recording, with_observation: Callable[..., Recording]
) -> None:
    assert codes(look(recording)) == set()
    assert codes(look(with_observation())) == set()


@pytest.mark.parametrize(
    ("path", "value", "code"),
    [
        ("identity_stable.value", False, "identity_switch"),
        ("log.identity_switch", True, "identity_switch"),
        ("log.safety_abort", True, "safety_abort"),
        ("visibility.participants.ot1.value", 0.3, "observation_differs"),
        ("visibility.conflict_region.value", "never", "observation_differs"),
    ],
)
def test_what_a_person_saw_happen_counts_beside_our_own_log_and_camera(
    path: str, value: Any, code: str, with_observation: Callable[..., Recording]
) -> None:
    assert codes(look(with_observation(path, value))) == {code}
    assert codes(look(with_observation(path, value, "Bo Ek"))) == {code}


@pytest.mark.parametrize(
    ("path", "value", "code", "text"),
    [
        ("source_gate.deformation.value", True, "source_rejected", "as Ada Vance saw"),
        ("dominant_motion.value", "cutting_in_from_right", "observation_differs", "Ada Vance says"),
        ("topology.segment", "curve", "observation_differs", "by Ada Vance says segment curve"),
        ("phases.trigger.t_s", 2.0, "observation_differs", "the trigger: observed by Ada Vance"),
    ],
)
def test_another_observer_takes_no_refusal_back(
    path: str, value: Any, code: str, text: str, with_observation: Callable[..., Recording]
) -> None:
    (finding,) = look(with_observation(path, value, "Bo Ek")).findings
    assert (finding.code, text in finding.detail) == (code, True)
    both = look(with_observation("who", "Ada Vance", "Bo Ek"))
    assert (both.findings, both.history.source) == ((), look(with_observation()).history.source)


def test_logs_that_differ_count_for_neither_observer(
    with_observation: Callable[..., Recording],
) -> None:
    one = with_observation("log.site_changes", ["a barrier moved"], "Bo Ek")
    history = examine_history(look(replace(one, provenance=replace(one.provenance, run=None))))
    assert history.source == "nobody"
    assert [(c.field, c.who) for c in history.changes] == [
        ("a barrier moved", "declared by Ada Vance")
    ]


def test_a_camera_that_somebody_guessed_shows_nothing(
    recording: Recording, with_observation: Callable[..., Recording]
) -> None:
    guessed = replace(recording.provenance, camera="assumed")
    assert codes(look(replace(recording, provenance=guessed))) == {"coverage_unknown"}
    one = look(replace(with_observation(), provenance=guessed))
    assert (codes(one), one.coverage.source) == (set(), "observed")


def test_the_doubt_of_the_k_stars_times_is_not_that_of_what_a_person_saw(
    with_observation: Callable[..., Recording],
) -> None:
    start = EVENT.events.trigger.start
    assert start != "unresolved"
    trigger = EVENT.events.trigger.model_copy(
        update={"start": start.model_copy(update={"min": 2.8, "max": 3.3})}
    )
    wide = EVENT.model_copy(update={"events": EVENT.events.model_copy(update={"trigger": trigger})})
    one = examine(replace(with_observation(), series=[]), wide, VERSION)
    assert one.phases_source == "observed"
    assert one.phi_half == {}


def test_states_without_a_road_and_an_observation_complete_each_other(
    with_observation: Callable[..., Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    def bare(_: Recording) -> RoadFacts | None:
        return None

    monkeypatch.setattr(Recording, "road", property(bare))
    one = look(with_observation())
    assert codes(one) == set()
    assert one.values[TOPOLOGY].source == "observed"
    assert one.properties[ROLES].words is not None
    assert one.properties[ROLES].words["ot1 starts in"] == ("left_lane",)


def test_an_observation_is_held_against_all_that_counts_before_it() -> None:
    road = {"segment": ("straight",)}
    states = Evidence("states", "the states", {}, {"trigger": 3.0})
    reviewed = Evidence("reviewed", "the K*", {TOPOLOGY: Property(road, "reviewed")}, None)
    bent = {TOPOLOGY: Property({"segment": ("curve",)}, "seen")}
    person = Evidence("observed", "Ada", bent, None)
    (found,) = observed_differences([states, reviewed, person])
    assert found.text == "topology: Ada says segment curve, not straight; the K*: reviewed"
    # Who takes part isn't left to one of them.
    two = {"vut": ("VUT, car",), "ot1": ("OT, car",)}
    states = Evidence("states", "the states", {ROLES: Property(two, "classes")}, None)
    three = {ROLES: Property({**two, "ot2": ("OT, car",)}, "seen")}
    (found,) = observed_differences([states, Evidence("observed", "Ada", three, None)])
    assert "ot2 OT, car, not absent" in found.text
    assert found.refuses


STARTS = {"trigger": 3.0, "conflict": 3.2, "resolution": 5.0}


def differences_of(starts: dict[str, float], source: Source = "states") -> list[Difference]:
    counts = Evidence(source, "it", {}, STARTS)
    return observed_differences([counts, Evidence("observed", "Ada", {}, {**STARTS, **starts})])


@pytest.mark.parametrize("phase", ["conflict", "resolution"])
def test_a_prediction_that_nobody_sees_refuses_nothing(phase: str) -> None:
    """TTC and arrival gap give these instants; a person sees a car come closer."""
    (found,) = differences_of({phase: STARTS[phase] + 0.9})
    assert not found.refuses
    assert found.text.startswith(f"the {phase}: Ada says ")
    assert "a prediction" in found.text
    # Reviewed persons looked at the same pictures, and the manoeuvre itself can be seen.
    (found,) = differences_of({phase: STARTS[phase] + 0.9}, "reviewed")
    assert found.refuses
    (found,) = differences_of({"trigger": 3.4})
    assert found.refuses
    # Nor can a phase be seen that isn't there at all.
    nowhere = Evidence("states", "it", {}, {"trigger": 3.0})
    both = observed_differences([nowhere, Evidence("observed", "Ada", {}, STARTS)])
    assert [one.refuses for one in both] == [True, True]


def test_a_field_that_may_vary_refuses_nothing() -> None:
    road = {"segment": ("straight",), "right_boundary": ("verge",)}
    states = Evidence("states", "the states", {TOPOLOGY: Property(road, "the road")}, None)
    seen = {"segment": ("curve",), "right_boundary": ("sidewalk",)}
    person = Evidence("observed", "Ada", {TOPOLOGY: Property(seen, "seen")}, None)
    found = observed_differences([states, person], {"right_boundary"})
    assert [(one.refuses, one.text) for one in found] == [
        (True, "topology: Ada says segment curve, not straight; the states: the road"),
        (
            False,
            "topology: Ada says right_boundary sidewalk, not verge; the states: it may vary "
            "between domains",
        ),
    ]
    assert all(one.refuses for one in observed_differences([states, person]))


def test_an_honest_observer_of_states_is_told_and_admitted(
    recording: Recording, with_observation: Callable[..., Recording]
) -> None:
    """The conflict half a second later than predicted, and a verge where the site has a kerb."""
    phases = look(recording).phases
    assert phases is not None
    assert phases.conflict_s is not None
    for path, value in (
        ("phases.conflict.t_s", phases.conflict_s + 0.6),
        ("topology.right_boundary", "verge"),
    ):
        one = look(with_observation(path, value))
        assert codes(one) == set()
        assert len([text for text in one.contradictions if "Ada Vance says" in text]) == 1
    for path, value in (
        ("topology.segment", "curve"),
        ("dominant_motion.value", "crossing_from_left"),
        ("phases.trigger.t_s", 0.5),
    ):
        assert "observation_differs" in codes(look(with_observation(path, value)))


def test_video_that_goes_on_without_states_locates_no_phase(recording: Recording) -> None:
    phases = look(recording).phases
    assert phases is not None
    assert phases.resolution_s is not None
    assert phases.trigger_s is not None
    upto_s, from_s = phases.resolution_s + 0.1, phases.trigger_s - 0.1
    ends = [x for x in recording.series if x[0] <= upto_s]
    assert codes(look(replace(recording, series=ends))) == {"resolution_phase"}
    begins = [x for x in recording.series if x[0] >= from_s]
    assert codes(look(replace(recording, series=begins))) == {"approach_phase"}


def test_another_crop_of_the_source_is_one_with_states_too(recording: Recording) -> None:
    digest = "sha256:" + "5" * 64
    source = EVENT.source.model_copy(update={"sha256": digest})
    bound = seal_event(EVENT.model_copy(update={"source": source}))
    record = ImportRecord.model_validate(
        {
            "schema": "ssp.import/2",
            "source": {"sha256": digest},
            "crop": {"start_s": 0.2, "end_s": 9.0},
            "generator": "ssp-clip/1",
            "domain": "synthetic",
            "scenario": "cut_in",
            "event_version": event_version(bound),
            "ego": {"provenance": "measured", "speed_mps": None},
            "camera": {
                "provenance": "measured",
                "hfov_deg": None,
                "height_m": None,
                "pitch_down_rad": None,
            },
            "states": {"name": "t", "sha256": digest, "vut": "vut", "objects": {"ot1": "car"}},
        }
    )
    facts = replace(
        recording.provenance, run=None, imported=record, event_version=event_version(bound)
    )
    one = examine(replace(recording, provenance=facts), bound, event_version(bound))
    assert one.phases_source == "states"
    (found,) = [finding for finding in one.findings if finding.code == "other_source"]
    assert found.detail == "the crop's start is 0.2 s, the K*'s clip's is 0 s"


def test_states_that_are_no_numbers_are_lost_ones(
    bag_writer: Any,
    poses_of_k_star: Callable[..., Any],
    make_task: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A car without a place while in conflict was in none, and the conflict was over."""

    def broken(t_s: float, *rest: float) -> Any:
        own, other = poses_of_k_star(t_s, *rest)
        return own, (nan, *other[1:]) if t_s > 5.0 else other

    monkeypatch.setitem(bag_writer.__globals__, "k_star_poses", broken)
    task = make_task(lanes=2)
    bag = bag_writer(tmp_path / "bag", task=task, like_k_star=True, duration_s=12.0)
    one = look(read_recording(bag))
    assert "identity_switch" in codes(one)
    assert any("ot1 is gone" in text for text in one.history.identities)


def test_the_only_lane_of_a_road_is_not_any_lane_of_another(
    recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """K* lets the number of lanes vary: Synthetic's one lane is rightmost and leftmost."""
    road = EVENT.topology
    lanes = road.lanes_same_direction.model_copy(update={"identity": False})
    free = EVENT.model_copy(
        update={"topology": road.model_copy(update={"lanes_same_direction": lanes})}
    )
    assert "lanes_same_direction" not in free.topology.identity_fields

    def with_lane(recording: Recording, *given: Any) -> Examination:
        one = examining.examine(recording, *given)
        domain = recording.provenance.domain
        lane = ("rightmost", "leftmost") if domain == "synthetic" else ("leftmost",)
        value = one.values[TOPOLOGY]
        words = {**(value.property.words or {}), "vut_lane": lane}
        topology = replace(value, property=Property(words, "made up"))
        return replace(one, values={**one.values, TOPOLOGY: topology})

    monkeypatch.setattr("ssp_eval.audit.judge.examine", with_lane)
    three = [
        replace(recording, provenance=replace(recording.provenance, domain=d))
        for d in ("synthetic", "simulation", "physical")
    ]
    entries = judge(three, free).audit.recordings
    primary = [{f.code for r in e.reasons for f in (r, *r.consequences)} for e in entries]
    assert "lane_differs" not in primary[0]
    assert "lane_differs" in primary[1]
    assert entries[1].kpr == 0.8


def test_without_the_sources_window_there_is_no_phi(recording: Recording) -> None:
    """Standing start and run-out would be in it: METHOD 4.1 has no clip then."""
    clip = EVENT.events.clip.model_copy(update={"start": "unresolved"})
    events = EVENT.events.model_copy(update={"clip": clip})
    one = examine(recording, EVENT.model_copy(update={"events": events}), VERSION)
    assert one.phases is not None
    assert (one.phi, codes(one)) == ({}, {"epd_missing"})
