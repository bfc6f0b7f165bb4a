"""The publishers of a session's topics: a stranger is found, and no member is taken for one."""

from __future__ import annotations

import pytest

from ssp_core import names
from ssp_core.run_file.driven import Driven
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.publishers import (
    NAMELESS,
    ONE,
    Publisher,
    PublisherRules,
    Strangers,
    declarations,
    expected_publishers,
    is_process,
    known_strangers,
    whence,
)
from tests.support.runs import small_run

MANAGER = Publisher("/ssp/scenario_manager", b"manager")
OBJECTS = Publisher("/ssp/object_target", b"objects")
FAR = Publisher("/ssp/object_target", b"of another host")
RECORDER = Publisher("/ssp/monitor", b"monitor")
RUNNER = Publisher("/ssp/ssp_run", b"runner")
STRANGER = Publisher("/ssp/intruder", b"stranger")
ALONE = [
    *(names.HEARTBEAT, names.SESSION_STATE, names.TRIGGER_EVENT, names.PHASE_EVENT, names.CLOCK),
    *(names.LINK_STATUS, names.RECORDER_STATUS, names.WORLD_TICK, names.CAMERA_IMAGE),
    *(names.state_topic("vut"), names.state_topic("ot1"), names.reference_topic("ot1")),
    *(names.ack_topic("ot1"), names.rules_topic("ot1"), names.iso_frames_topic("ot1")),
]
SHARED = [names.STEP_DONE, names.HEARTBEAT_REPLY, names.ACTUATOR_COMMANDS, names.OBJECT_STATES]


def run(**changes: object) -> RunSpec:
    return RunSpec.model_validate(small_run(**changes))


@pytest.fixture
def rules() -> PublisherRules:
    made = PublisherRules(run())
    made.know(
        {
            names.SESSION_STATE: [MANAGER],
            names.ack_topic("ot1"): [OBJECTS],
            names.RECORDER_STATUS: [RECORDER],
        }
    )
    return made


@pytest.mark.parametrize("topic", ALONE)
def test_a_second_publisher_is_a_stranger(rules: PublisherRules, topic: str) -> None:
    assert rules.strangers(topic, []) is None
    assert rules.strangers(topic, [OBJECTS]) is None
    text = f"{topic} has /ssp/intruder and /ssp/object_target"
    assert rules.strangers(topic, [OBJECTS, STRANGER]) == Strangers(1, text)


def test_a_rehearsal_may_declare_what_an_object_target_declares_too() -> None:
    """Two that agree are no strangers; two that don't are found by their words."""
    live = run(mode="live")
    assert names.declared_topic("ot1/body") in declarations(live)
    assert not PublisherRules(live).expected.keys() & set(declarations(live))
    assert declarations(run()) == ()


def test_a_driver_that_is_asked_publishes_its_answers_and_the_vuts_references() -> None:
    driven = Driven(driver="no_response", first_request_s=1.0, hand_over_s=2.0, end_s=9.0)
    asked = run().model_copy(update={"driven": driven})
    more = expected_publishers(asked).keys() - expected_publishers(run()).keys()
    assert more == {
        names.vla_request_topic("no_response"),
        names.vla_response_topic("no_response"),
        names.vla_latency_topic("no_response"),
        names.reference_topic("vut"),
        names.ack_topic("vut"),
    }
    assert expected_publishers(run()).keys() <= expected_publishers(asked).keys()
    assert all(expected_publishers(asked)[topic] == ONE for topic in more)
    assert expected_publishers(run())[names.state_topic("ot1")] == ONE


def test_of_drivers_outside_the_session_those_of_the_last_call_are_expected(
    rules: PublisherRules,
) -> None:
    before = dict(rules.expected)
    rules.expect_one(["/a", "/b"])
    assert rules.expected == before | {"/a": ONE, "/b": ONE}
    assert rules.strangers("/a", [STRANGER]) is None
    assert rules.strangers("/a", [STRANGER, RUNNER]) is not None
    rules.expect_one(["/b", "/c"])
    assert rules.expected == before | {"/b": ONE, "/c": ONE}
    rules.expect_one([])
    assert rules.expected == before


@pytest.mark.parametrize("topic", SHARED)
def test_a_shared_topic_is_for_the_processes_of_the_session(
    rules: PublisherRules, topic: str
) -> None:
    assert rules.strangers(topic, [OBJECTS]) is None
    text = f"{topic} has /ssp/intruder beside this session's own"
    assert rules.strangers(topic, [OBJECTS, STRANGER]) == Strangers(1, text)
    assert rules.strangers(topic, [STRANGER]) == Strangers(1, text)
    # The same process twice, and one of that name that has no object of the run.
    assert rules.strangers(topic, [OBJECTS, OBJECTS]) is not None
    assert rules.strangers(topic, [OBJECTS, FAR]) is not None


def test_a_state_shows_a_process_of_objects_as_an_acknowledgement_does() -> None:
    for topic in (names.ack_topic("ot1"), names.state_topic("ot1")):
        rules = PublisherRules(run())
        rules.know({topic: [OBJECTS]})
        assert rules.strangers(names.HEARTBEAT_REPLY, [OBJECTS]) is None
        assert topic in rules.proofs


def test_every_process_of_objects_belongs_to_the_session(rules: PublisherRules) -> None:
    two = PublisherRules(run(targets=[*small_run()["targets"], _another("ot2")]))
    two.know({names.ack_topic("ot1"): [OBJECTS], names.ack_topic("ot2"): [FAR]})
    assert two.strangers(names.HEARTBEAT_REPLY, [OBJECTS, FAR]) is None
    # A part that isn't there proves nothing; one with two publishers neither.
    rules.know({names.ack_topic("ot1"): [OBJECTS, STRANGER], names.WORLD_TICK: []})
    assert rules.strangers(names.HEARTBEAT_REPLY, [OBJECTS, STRANGER]) is not None


def _another(object_id: str) -> dict[str, object]:
    return {**small_run()["targets"][0], "id": object_id}


def test_steps_are_answered_by_all_parts_and_replies_by_objects_alone(
    rules: PublisherRules,
) -> None:
    everybody = [MANAGER, OBJECTS, RECORDER]
    assert rules.strangers(names.STEP_DONE, everybody) is None
    found = rules.strangers(names.HEARTBEAT_REPLY, everybody)
    assert found is not None
    assert found.count == 2


def test_the_runner_sends_references_only_where_the_run_asks_for_them(
    rules: PublisherRules,
) -> None:
    topic = names.reference_topic("ot1")
    assert rules.strangers(topic, [MANAGER, RUNNER]) is not None
    fault = {"kind": "reference_stale", "target": "ot1", "at_s": 1.0}
    asked = PublisherRules(run(faults=[fault]))
    asked.know({names.SESSION_STATE: [MANAGER]})
    assert asked.strangers(topic, [MANAGER, RUNNER]) is None
    assert asked.strangers(topic, [MANAGER, RUNNER, STRANGER]) is not None
    assert rules.strangers(names.FAULT_EVENT, [RUNNER, OBJECTS]) is None
    # A fault of another kind asks for none, nor does one of another object.
    both = [*small_run()["targets"], _another("ot2")]
    for one in (fault | {"target": "ot2"}, fault | {"kind": "state_nan"}):
        other = PublisherRules(run(faults=[one], targets=both))
        other.know({names.SESSION_STATE: [MANAGER]})
        assert other.strangers(topic, [MANAGER, RUNNER]) is not None


@pytest.mark.parametrize("topic", [names.STEP_DONE, names.SESSION_STATE])
def test_of_two_managers_that_were_there_before_neither_is_called_the_stranger(topic: str) -> None:
    late = PublisherRules(run())
    other = Publisher("/ssp/other_manager", b"other")
    late.know({names.SESSION_STATE: [MANAGER, other], names.ack_topic("ot1"): [OBJECTS]})
    found = late.strangers(topic, [MANAGER, other])
    assert found is not None
    assert found.count == (1 if topic == names.SESSION_STATE else 2)
    assert found.text.startswith(f"{topic} has /ssp/other_manager and /ssp/scenario_manager")
    assert "beside this session's own" not in found.text
    # Of the objects it is known, and so it is of the manager when one of both has gone.
    known = late.strangers(names.HEARTBEAT_REPLY, [OBJECTS, STRANGER])
    assert known is not None
    assert known.text == f"{names.HEARTBEAT_REPLY} has /ssp/intruder beside this session's own"
    late.know({names.SESSION_STATE: [MANAGER]})
    assert late.strangers(names.STEP_DONE, [MANAGER, OBJECTS]) is None
    gone = late.strangers(names.STEP_DONE, [MANAGER, other])
    assert gone is not None
    assert gone.text.endswith("has /ssp/other_manager beside this session's own")


def test_a_node_whose_name_is_not_known_yet(rules: PublisherRules) -> None:
    found = rules.strangers(names.HEARTBEAT, [MANAGER, Publisher("", b"stranger")])
    assert found is not None
    assert NAMELESS in found.text


def test_without_a_run_the_session_is_watched_all_the_same() -> None:
    rules = PublisherRules()
    assert names.state_topic("ot1") not in rules.expected
    assert rules.strangers(names.HEARTBEAT, [MANAGER, STRANGER]) is not None


@pytest.mark.parametrize(("age_s", "known"), [(0.0, True), (3.0, True), (3.001, False)])
def test_a_manager_that_is_silent_says_nothing_of_strangers(age_s: float, known: bool) -> None:
    found = known_strangers(["/clock has /x"], age_s, ["/tf has /y"])
    assert found == (("/clock has /x", "/tf has /y") if known else ("/tf has /y",))


OWN = bytes.fromhex("010f7f016a0897c600000000")


@pytest.mark.parametrize(
    ("process", "own", "said"),
    [
        ("010f7f01671297c600000000", OWN, "process 4711 of this host"),
        ("010f7f02671297c600000000", OWN, ""),  # another host
        ("01037f01671297c600000000", OWN, ""),  # another vendor, whose ids are made otherwise
        ("010f7f01671297c600000000", b"", ""),
    ],
)
def test_a_prefix_tells_the_process_of_this_host(process: str, own: bytes, said: str) -> None:
    assert whence(bytes.fromhex(process), own) == said
    assert is_process(OWN, 2154)
    assert is_process(OWN, 2154 + 65536)
    assert not is_process(OWN, 4711)
    named = Publisher("", OWN, said).name
    assert named == (f"{NAMELESS} ({said})" if said else NAMELESS)
    assert Publisher("/ssp/intruder", OWN, said).name == "/ssp/intruder"
