"""The end of a run on the page: heard from session or runner, never concluded from silence."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ssp_core.run_file.verdict import EndWord
from ssp_core.vocabulary import ControlState, SessionPhase, Verdict
from ssp_monitor.page.ending import NEXT, NEXT_BY_HAND, end_of
from ssp_monitor.page.snapshot import Snapshots
from ssp_monitor.status.board import Board, Event, EventList, SessionFact
from tests.support.states import object_state

S = 1_000_000_000
BY_HAND = "abort by operator page at 127.0.0.1 at 5.00 s"


def word(verdict: Verdict = Verdict.VALID, *, final: bool = True) -> EndWord:
    return EndWord(verdict, (), final, "out/run")


def board_of(*states: SessionPhase, verdict: Verdict = Verdict.VALID) -> Board:
    """A session that went through states from 100 s on, 5 s each, and was heard until 30 s."""
    board = Board()
    for k, state in enumerate(states):
        last = k == len(states) - 1
        reasons = (BY_HAND,) if last and verdict is Verdict.ABORTED else ()
        fact = SessionFact((100 + 5 * k) * S, state, verdict=verdict if last else Verdict.NONE)
        board.hear_session(replace(fact, reasons=reasons), (20 + k) * S)
    board.manager.at_ns = 30 * S
    return board


def aborted() -> Board:
    board = board_of(
        SessionPhase.ARMED,
        SessionPhase.RUNNING,
        SessionPhase.ABORTING,
        SessionPhase.ABORTED,
        verdict=Verdict.ABORTED,
    )
    board.events.add(Event("safety", 110 * S, "operator"))
    return board


def finished() -> Board:
    return board_of(
        SessionPhase.ARMED, SessionPhase.RUNNING, SessionPhase.STOPPING, SessionPhase.FINISHED
    )


def test_an_accepted_abort_ends_with_its_verdict_and_with_what_stood_when() -> None:
    end = end_of(aborted(), word(Verdict.ABORTED), 30 * S)
    assert end is not None
    assert end["head"] == "ended: aborted by the operator"
    assert (end["stands"], end["text"]) == (True, "everything stood at 10.0 s")
    assert end["next"] == f"{NEXT_BY_HAND} (out/run)"


def test_an_abort_of_another_cause_is_not_the_operators() -> None:
    board = aborted()
    board.events = EventList()
    board.events.add(Event("safety", 109 * S, "vut silent"))
    board.events.add(Event("safety", 110 * S, "operator"))
    end = end_of(board, word(Verdict.ABORTED), 30 * S)
    assert end is not None
    assert end["head"] == "ended: aborted"
    assert end["next"] == f"{NEXT[Verdict.ABORTED]} (out/run)"


@pytest.mark.parametrize("verdict", list(Verdict))
def test_the_runners_verdict_counts_and_says_what_comes_next(verdict: Verdict) -> None:
    """The session's own is valid: what the recording shows may be worse."""
    snapshots = Snapshots(finished())
    snapshots.word = word(verdict)
    shown = snapshots.snapshot(30 * S)
    assert shown["session"]["verdict"] == verdict.name
    assert NEXT[verdict] in shown["session"]["next"] == shown["end"]["next"]
    assert shown["end"]["head"].endswith(verdict.name.lower().replace("_", " "))


@pytest.mark.parametrize("make", [aborted, finished])
def test_after_the_end_silence_is_no_news(make) -> None:
    """The page used to go on warning of silence after every orderly end."""
    board = make()
    board.hear_states([object_state("ot1", stamp_ns=115 * S, speed_mps=0.0)], 23 * S)
    board.offered = frozenset()
    snapshots = Snapshots(board)
    snapshots.word = word(board.session.fact.verdict, final=False)
    first = snapshots.snapshot(31 * S)
    later = snapshots.snapshot(900 * S)
    assert first == later
    assert (later["stale"], later["blind"], later["leaderless"]) == ([], False, False)
    assert later["abort_unheard"] is False
    assert later["session"]["commands"] == []
    assert [one["speed"] for one in later["objects"]] == [0.0]
    assert not later["objects"][0]["stale"]


def test_a_session_led_by_hand_ends_when_its_manager_has_gone() -> None:
    board = finished()
    board.offered = frozenset({"abort", "reset"})
    assert end_of(board, None, 30 * S) is None  # another run may follow
    board.offered = frozenset()
    end = end_of(board, None, 30 * S)
    assert end is not None
    assert (end["head"], end["stands"]) == ("ended: valid", True)
    board.offered = None
    assert end_of(board, None, 30 * S) is None
    assert end_of(board, None, 32 * S) is not None


_GOING_ON = [s for s in SessionPhase if s not in (SessionPhase.FINISHED, SessionPhase.ABORTED)]


@pytest.mark.parametrize("state", _GOING_ON)
def test_silence_without_an_end_is_none(state: SessionPhase) -> None:
    """A manager that died or hangs: the page goes on shouting, however long it takes."""
    board = board_of(SessionPhase.ARMED, state, verdict=Verdict.NONE)
    board.offered = frozenset()
    snapshots = Snapshots(board)
    for now_s in (32, 60, 3600):
        shown = snapshots.snapshot(now_s * S)
        assert shown["end"] is None
        assert shown["stale"] == [f"the scenario manager is silent for {now_s - 30:.1f} s"]
        assert (shown["abort_unheard"], shown["leaderless"]) == (True, True)


@pytest.mark.parametrize(
    ("state", "stands"),
    [
        (SessionPhase.UNKNOWN, False),
        (SessionPhase.IDLE, True),
        (SessionPhase.LOADED, True),
        (SessionPhase.CONNECTED, True),
        (SessionPhase.ARMED, False),
        (SessionPhase.RUNNING, False),
        (SessionPhase.STOPPING, False),
        (SessionPhase.FINISHED, True),
        (SessionPhase.ABORTING, False),
        (SessionPhase.ABORTED, True),
    ],
)
def test_only_what_the_session_said_is_known_to_stand(state: SessionPhase, stands: bool) -> None:
    """The manager died while it drove, and the runner gave up: an end, and no standstill."""
    snapshots = Snapshots(board_of(state, verdict=Verdict.NONE))
    snapshots.word = word(Verdict.INVALID_HARNESS)
    shown = snapshots.snapshot(60 * S)
    assert shown["end"]["stands"] is stands
    assert shown["blind"] is not stands
    assert ("may be moving" in shown["end"]["text"]) is not stands
    assert ("keep clear" in shown["session"]["next"]) is not stands


def test_a_session_that_begins_again_is_shown_again() -> None:
    board = finished()
    snapshots = Snapshots(board)
    assert snapshots.snapshot(40 * S)["end"] is not None
    board.hear_session(SessionFact(130 * S, SessionPhase.LOADED), 41 * S)
    board.manager.at_ns = 41 * S
    board.hear_states([object_state("ot1", control_state=ControlState.ARMED)], 41 * S)
    shown = snapshots.snapshot(41 * S)
    assert shown["end"] is None
    assert [one["id"] for one in shown["objects"]] == ["ot1"]


def test_a_replay_has_no_end() -> None:
    board = finished()
    board.replay = True
    assert end_of(board, None, 60 * S) is None


def test_the_word_of_the_runner_is_read_as_it_was_sent() -> None:
    told = EndWord(Verdict.OFF_SPEC, ("gap: 3 m, wanted 5 m", "größer"), True, "/tmp/a b")
    assert EndWord.parse(told.line()) == told
    assert told.line().count(b"\n") == 1


@pytest.mark.parametrize("line", [b"", b"{}", b"[]", b"3", b'{"verdict": "x"}', b"\xff"])
def test_what_is_no_word_is_refused(line: bytes) -> None:
    with pytest.raises(ValueError, match=r"no end of a run|Expecting|decode"):
        EndWord.parse(line)
