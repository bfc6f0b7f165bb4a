"""A recorder's report: the contents of its bag, the losses, and the run's verdict."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.cdr.steps import Heartbeat, WorldTick, encode_heartbeat, encode_tick
from ssp_core.errors import InputError
from ssp_core.vocabulary import SessionPhase
from ssp_core.vocabulary import SessionPhase as P
from ssp_core.vocabulary import Verdict as V
from ssp_monitor.recorder import plan
from ssp_monitor.recorder.losses import (
    HEARTBEAT,
    SETTLED_S,
    TICK,
    Arrivals,
    LossesOfRun,
    RivalWatch,
    claims,
    losses_beside,
)
from ssp_monitor.recorder.plan import run_attachments
from ssp_monitor.recorder.report import RunOutcome


@pytest.fixture
def run_file(tmp_path):
    path = tmp_path / "run.yaml"
    path.write_text("schema: ssp.run/1\n")
    return path


def test_a_run_without_a_task_is_attached_alone(run_file):
    assert run_attachments(run_file) == [("run.yaml", "application/yaml", b"schema: ssp.run/1\n")]


def test_every_file_of_the_task_is_attached_under_its_name(run_file):
    task = run_file.parent / "task"
    (task / "deeper").mkdir(parents=True)
    for name, text in (
        ("task.json", "{}"),
        ("log.jsonl", ""),
        ("town.xodr", "<OpenDRIVE/>"),
        ("map.bin", "x"),
        ("deeper/no.json", "no"),
    ):
        (task / name).write_text(text)
    assert run_attachments(run_file)[1:] == [
        ("log.jsonl", "application/jsonl", b""),
        ("map.bin", "application/octet-stream", b"x"),
        ("task.json", "application/json", b"{}"),
        ("town.xodr", "application/xml", b"<OpenDRIVE/>"),
    ]


def test_a_run_in_the_task_would_hide_the_executed_one(run_file):
    task = run_file.parent / "task"
    task.mkdir()
    (task / "run.yaml").write_text("another")
    with pytest.raises(InputError, match=r"task/run\.yaml: has the name of the run itself"):
        run_attachments(run_file)


def test_what_is_too_large_is_refused_together(run_file, monkeypatch):
    task = run_file.parent / "task"
    task.mkdir()
    (task / "a.xodr").write_bytes(b"a" * 40)
    (task / "b.xodr").write_bytes(b"b" * 40)
    size = len(run_file.read_bytes()) + 80
    monkeypatch.setattr(plan, "MOST_BYTES", size)
    assert len(run_attachments(run_file)) == 3
    monkeypatch.setattr(plan, "MOST_BYTES", size - 1)
    with pytest.raises(InputError, match=r"b\.xodr: is too large"):
        run_attachments(run_file)


def test_a_missing_run_is_said(tmp_path):
    with pytest.raises(InputError, match=r"run\.yaml: can't be read"):
        run_attachments(tmp_path / "run.yaml")


A, B = b"a" * 16, b"b" * 16


def test_a_gap_is_a_loss_and_a_start_is_none():
    arrivals = Arrivals()
    assert [arrivals.note(A, n) for n in (7, 8, 12, 13)] == [0, 0, 3, 0]
    assert (arrivals.received, arrivals.gaps, arrivals.lost) == (4, 3, 3)


def test_what_was_lost_while_a_session_waited_is_no_loss_of_its_run():
    """One stall of a busy machine used to keep a live session from arming for good."""
    losses = LossesOfRun()
    losses.session_is(SessionPhase.CONNECTED)
    losses.look(86, 10.0)
    assert losses.of(86) == 86  # it may go on
    losses.look(86, 10.0 + SETTLED_S - 0.1)
    assert losses.of(86) == 86
    losses.look(86, 10.0 + SETTLED_S)
    assert (losses.of(86), losses.of(87), losses.before) == (0, 1, 86)


def test_what_goes_on_losing_may_not_arm():
    losses = LossesOfRun()
    for second in range(20):
        losses.look(second, float(second))
    assert losses.of(19) == 19


@pytest.mark.parametrize("state", [s for s in SessionPhase if s >= SessionPhase.ARMED])
def test_from_arming_on_every_loss_counts(state):
    losses = LossesOfRun()
    losses.look(5, 0.0)
    losses.look(5, 3.0)
    losses.session_is(state)
    for second in range(4, 20):
        losses.look(7, float(second))
    assert losses.of(7) == 2


def test_a_loss_of_a_run_counts_when_the_manager_is_reset_after_it():
    losses = LossesOfRun()
    for state in (SessionPhase.ARMED, SessionPhase.RUNNING, SessionPhase.FINISHED):
        losses.session_is(state)
    losses.look(2, 10.0)
    losses.session_is(SessionPhase.IDLE)
    losses.look(2, 100.0)
    assert losses.of(2) == 2


def test_a_loss_while_objects_were_armed_is_forgotten_once_they_are_disarmed():
    losses = LossesOfRun()
    losses.session_is(SessionPhase.ARMED)
    losses.look(2, 10.0)
    losses.look(2, 20.0)
    assert losses.of(2) == 2
    losses.session_is(SessionPhase.CONNECTED)
    losses.look(2, 20.5)
    assert losses.of(2) == 0


def test_publishers_count_for_themselves():
    arrivals = Arrivals()
    heard = [(A, 1), (B, 500), (A, 2), (B, 501), (B, 504), (A, 3)]
    assert [arrivals.note(*one) for one in heard] == [0, 0, 0, 0, 2, 0]
    assert (arrivals.lost, arrivals.publishers) == (2, 2)


def test_who_speaks_again_after_another_has_is_counted_and_a_successor_is_not():
    arrivals = Arrivals()
    for publisher in (A, A, B, B):
        arrivals.note(publisher, 1)
    assert arrivals.returned == 0
    arrivals.note(A, 3)
    assert arrivals.returned == 1
    arrivals.note(B, 3)
    arrivals.note(B, 4)
    assert arrivals.returned == 2


def test_rivals_count_where_there_is_one_publisher_and_while_a_session_is_under_way():
    watch = RivalWatch({"/a", "/c"})
    assert watch.look({"/a": 4}) == ()
    watch.begin({"/a": 4})
    assert watch.is_on
    watch.begin({"/a": 7})  # armed, then running: it counts from the first
    assert watch.look({"/a": 4, "/b": 9, "/c": 0}) == ()
    text = "/a has messages of two publishers in turn"
    assert watch.look({"/a": 5, "/c": 0}) == (text,)
    watch.end()
    assert not watch.is_on
    assert watch.look({"/a": 5, "/c": 3}) == (text,)


def test_a_publisher_that_starts_over_has_lost_nothing():
    arrivals = Arrivals()
    for publisher, sequence in ((A, 90), (A, 91), (B, 1), (B, 2)):
        assert arrivals.note(publisher, sequence) == 0
    # As where the middleware doesn't tell publishers apart.
    assert [arrivals.note(A, n) for n in (1, 2, 4)] == [0, 0, 1]
    assert arrivals.lost == 1


def test_messages_without_numbers_are_received_and_prove_nothing():
    arrivals = Arrivals()
    assert [arrivals.note(A, n) for n in (4, 0, 0, 5, 0)] == [0, 0, 0, 0, 0]
    assert (arrivals.received, arrivals.lost) == (5, 0)


def test_what_two_tell_of_the_same_counts_once():
    arrivals = Arrivals()
    arrivals.note(A, 1)
    arrivals.note(A, 4)
    arrivals.middleware_losses = 1
    assert arrivals.lost == 2
    arrivals.middleware_losses = 5
    assert arrivals.lost == 5


@pytest.mark.parametrize(("sent", "behind"), [(0, 0), (8, 0), (9, 0), (12, 3)])
def test_what_a_publisher_claims_shows_what_is_missing_at_the_end(sent, behind):
    arrivals = Arrivals()
    arrivals.note(A, 6)
    arrivals.note(A, 9)
    arrivals.claimed(sent)
    assert (arrivals.behind, arrivals.lost) == (behind, 2 + behind)


def test_a_claim_proves_nothing_about_several_publishers_or_none():
    arrivals = Arrivals()
    arrivals.claimed(5)
    assert arrivals.lost == 0
    arrivals.note(A, 1)
    arrivals.note(B, 1)
    arrivals.claimed(5)
    assert arrivals.lost == 0


@given(
    st.dictionaries(
        st.binary(min_size=16, max_size=16),
        st.sets(st.integers(1, 60), min_size=1),
        min_size=1,
        max_size=4,
    ),
    st.randoms(use_true_random=False),
)
def test_received_and_lost_make_up_the_whole(heard, order):
    """Publishers may be heard in any order: each keeps its own messages in its own order."""
    arrivals = Arrivals()
    waiting = {publisher: sorted(numbers) for publisher, numbers in heard.items()}
    while waiting:
        publisher = order.choice(sorted(waiting))  # type: ignore[attr-defined]
        arrivals.note(publisher, waiting[publisher].pop(0))
        if not waiting[publisher]:
            del waiting[publisher]
    spans = sum(max(numbers) - min(numbers) + 1 for numbers in heard.values())
    assert arrivals.received + arrivals.lost == spans


def beat(**references: int) -> bytes:
    return encode_heartbeat(Heartbeat(0, "manager", 1, 0, SessionPhase.RUNNING, references))


def test_claims_name_the_topics_that_are_counted():
    tick = encode_tick(WorldTick(0, 7, True, True, 3, 41))
    assert claims({TICK: tick, HEARTBEAT: beat(ot1=3, walker=0)}) == {
        "/ssp/vut/state": 41,
        "/ssp/ot1/reference": 3,
        "/ssp/walker/reference": 0,
    }
    assert claims({}) == {}


def test_a_message_that_cannot_be_read_claims_nothing():
    assert claims({TICK: b"\x00\x01\x00\x00", HEARTBEAT: beat(ot1=3)}) == {"/ssp/ot1/reference": 3}


@given(st.binary(max_size=80), st.binary(max_size=80))
def test_no_bytes_make_claims_fail(tick, heartbeat):
    head = b"\x00\x01\x00\x00"
    claims({TICK: head + tick, HEARTBEAT: head + heartbeat})


def test_losses_beside_the_run_are_one_sentence():
    own = frozenset(["/run"])
    assert losses_beside({"/run": 3, "/x": 0}, own) == []
    assert losses_beside({"/run": 3, "/b": 2, "/a": 1}, own) == [
        "3 messages of topics beside the run's are missing: /a, /b"
    ]
    many = losses_beside({f"/t{k}": 1 for k in range(9)}, own)
    assert many == [
        "9 messages of topics beside the run's are missing: /t0, /t1, /t2, /t3, /t4, ..."
    ]
    # Without a run all topics count, and lost messages speak for themselves.
    assert losses_beside({"/a": 1}, frozenset()) == []


WAY = [P.IDLE, P.LOADED, P.CONNECTED, P.ARMED, P.RUNNING]


def outcome_after(*words: P | tuple[P, V, tuple[str, ...]], run_id: str = "run-1") -> RunOutcome:
    last = RunOutcome("run-1")
    for word in words:
        state, verdict, reasons = word if isinstance(word, tuple) else (word, V.NONE, ())
        last.hear(state, verdict, reasons, run_id)
    return last


def test_a_run_that_ended_well():
    last = outcome_after(*WAY, P.STOPPING, (P.FINISHED, V.VALID, ()))
    assert last.verdict(0) == (V.VALID, ())
    assert not last.is_due
    # A reset takes nothing back.
    last.hear(P.IDLE, V.NONE, (), "")
    assert last.verdict(0) == (V.VALID, ())


@pytest.mark.parametrize("verdict", [V.ABORTED, V.FAILED_SAFETY, V.INVALID_HARNESS])
def test_the_sessions_own_verdict_and_reasons_come_first(verdict):
    last = outcome_after(
        *WAY, (P.ABORTING, verdict, ("one",)), (P.ABORTED, verdict, ("one", "two"))
    )
    assert last.verdict(0) == (verdict, ("one", "two"))
    assert last.verdict(3) == (verdict, ("one", "two", "the recorder lost 3 messages"))


def test_losses_make_a_valid_run_invalid():
    last = outcome_after(*WAY, P.STOPPING, (P.FINISHED, V.VALID, ()))
    assert last.verdict(1) == (V.INVALID_HARNESS, ("the recorder lost 1 messages",))


@pytest.mark.parametrize("state", WAY)
def test_a_recording_that_ends_too_early(state):
    last = outcome_after(*WAY[: WAY.index(state) + 1])
    reason = f"the recording ends while the session is {state.name}"
    assert last.verdict(0) == (V.INVALID_HARNESS, (reason,))
    assert last.is_due == (state in (P.ARMED, P.RUNNING))


def test_an_abort_that_did_not_come_to_its_end():
    last = outcome_after(*WAY, (P.ABORTING, V.FAILED_SAFETY, ("collision",)))
    assert last.is_due
    assert last.verdict(0) == (
        V.FAILED_SAFETY,
        ("collision", "the recording ends while the session is ABORTING"),
    )


def test_no_session_at_all():
    assert RunOutcome("run-1").verdict(0) == (V.INVALID_HARNESS, ("no session was heard",))


def test_two_runs_in_one_recording_are_none():
    well = (P.STOPPING, (P.FINISHED, V.VALID, ()))
    verdict, reasons = outcome_after(*WAY, *well, *WAY, *well).verdict(0)
    assert (verdict, reasons) == (V.INVALID_HARNESS, ("2 runs are in one recording",))


def test_the_run_of_another_file():
    verdict, reasons = outcome_after(*WAY, (P.FINISHED, V.VALID, ()), run_id="run-2").verdict(0)
    assert verdict is V.INVALID_HARNESS
    assert reasons == ("the session ran run-2, the recording is of run-1",)


def test_losses_within_the_limit_are_no_reason():
    last = outcome_after(*WAY, P.STOPPING, (P.FINISHED, V.VALID, ()))
    assert last.verdict(5, lost_limit=5) == (V.VALID, ())
    reason = "the recorder lost 6 messages, limit 5"
    assert last.verdict(6, lost_limit=5) == (V.INVALID_HARNESS, (reason,))


def test_a_bag_that_is_not_as_it_must_be_makes_a_run_invalid():
    last = outcome_after(*WAY, P.STOPPING, (P.FINISHED, V.VALID, ()))
    problems = ("/clock: 9 messages in the bag, 10 were received",)
    assert last.verdict(0, problems=problems) == (V.INVALID_HARNESS, problems)
