"""The end of a run as the page shows it: the verdict, what stood when, and what comes next.

An end is heard, never concluded from silence: the session's own last state says it, or the word of
the runner that led it.
"""

from __future__ import annotations

from typing import Any

from ssp_core.run_file.verdict import EndWord
from ssp_core.vocabulary import SessionPhase, Verdict
from ssp_monitor.status.board import OVER, STALE_S, Board

# What a person does after a run, by its verdict.
NEXT: dict[Verdict, str] = {
    Verdict.NONE: "look at the terminal: the run has no verdict",
    Verdict.VALID: "check the recording, then prepare the next run in the terminal",
    Verdict.OFF_SPEC: "compare the measured event in result.json with the K*, then repeat the run",
    Verdict.ABORTED: "fix the named cause, then repeat the run",
    Verdict.FAILED_SAFETY: "stop, and find out why before the next run",
    Verdict.INVALID_HARNESS: "fix the equipment; this recording is unusable",
}
NEXT_BY_HAND = "repeat the run, once the reason for the abort is gone"
_UNARMED = (SessionPhase.IDLE, SessionPhase.LOADED, SessionPhase.CONNECTED)
# As messages.safety_event titles what a person asked for.
_BY_HAND = "operator"


def end_of(board: Board, word: EndWord | None, now_ns: int) -> dict[str, Any] | None:
    """Return the end that was heard, as JSON values; None while the session may go on.

    Args:
        board: what was heard.
        word: of the runner that leads the session; None: it has said nothing, or there is none.
        now_ns: on the steady clock.

    Returns:
        ``head`` is the verdict in words, ``stands`` whether everything is known to stand, and
        ``text`` since when.
    """
    if board.replay or (word is None and not _has_left(board, now_ns)):
        return None
    stands, text = _standing(board)
    return {
        "head": f"ended: {_verdict(board, word)}",
        "text": text,
        "stands": stands,
        "next": _next(board, word, stands),
    }


def verdict_of(board: Board, word: EndWord | None) -> tuple[Verdict, tuple[str, ...]]:
    """Return verdict and reasons: the runner's, which knows more, or else the session's own."""
    if word is not None:
        return word.verdict, word.reasons
    fact = board.session.fact
    return (Verdict.NONE, ()) if fact is None else (fact.verdict, fact.reasons)


def _has_left(board: Board, now_ns: int) -> bool:
    """Tell whether the session is over and its manager, which could begin another, has gone."""
    if board.session.state not in OVER:
        return False
    unheard = board.offered is not None and "abort" not in board.offered
    return unheard or board.manager.silent_s(now_ns) > STALE_S


def _standing(board: Board) -> tuple[bool, str]:
    fact, state = board.session.fact, board.session.state
    if state in _UNARMED:
        return True, "no object was armed"
    if state in OVER:
        at_s = board.elapsed_s
        return True, "everything stood" + ("" if at_s is None else f" at {at_s:.1f} s")
    why = f" ({fact.reason})" if fact and fact.reason else ""
    session_text = f"the session was {state.name}{why} when it was last heard"
    return False, f"{session_text}, and no standstill was reported. Objects may be moving."


def _verdict(board: Board, word: EndWord | None) -> str:
    verdict, _ = verdict_of(board, word)
    if verdict is Verdict.ABORTED and _is_by_hand(board):
        return "aborted by the operator"
    return verdict.name.lower().replace("_", " ")


def _is_by_hand(board: Board) -> bool:
    """Tell whether the first safety event of this run is a person's abort."""
    since_ns = board.session.started_ns or 0
    for _, event in board.events:
        if event.kind == "safety" and event.stamp_ns >= since_ns:
            return event.title == _BY_HAND
    return False


def _next(board: Board, word: EndWord | None, stands: bool) -> str:
    if not stands:
        return "keep clear until you have seen that everything stands"
    if word is not None and not word.final:
        return "wait until the recording is closed; the verdict may still change"
    verdict, _ = verdict_of(board, word)
    by_hand = verdict is Verdict.ABORTED and _is_by_hand(board)
    text = NEXT_BY_HAND if by_hand else NEXT[verdict]
    return f"{text} ({word.folder})" if word is not None and word.folder else text
