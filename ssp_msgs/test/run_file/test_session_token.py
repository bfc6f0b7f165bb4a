"""The session that a command is for: simulated ones must not reach live ones, nor the reverse."""

from __future__ import annotations

import pytest

from ssp_core.run_file.session_token import draw_token, mode_problem, token_problem

LIVE, SIM = "live-0123456789", "sim-0123456789"


def test_each_session_has_a_token_of_its_own() -> None:
    drawn = {draw_token(mode) for mode in ("live", "lockstep", "realtime") for _ in range(50)}
    assert len(drawn) == 150
    assert {token.partition("-")[0] for token in drawn} == {"live", "sim"}
    assert not mode_problem(draw_token("live"), "live")
    assert not mode_problem(draw_token("realtime"), "lockstep")


@pytest.mark.parametrize(
    ("token", "mode", "told"),
    [
        ("", "live", ""),
        ("", "lockstep", ""),
        (LIVE, "live", ""),
        (LIVE, "realtime", "is live, and the run's mode is realtime"),
        (SIM, "live", "is simulated, and the run's mode is live"),
    ],
)
def test_a_session_takes_runs_of_its_kind(token: str, mode: str, told: str) -> None:
    found = mode_problem(token, mode)
    assert found.endswith(told)
    assert bool(found) == bool(told)


@pytest.mark.parametrize(
    ("own", "given", "mode", "told"),
    [
        (LIVE, LIVE, "live", ""),
        (SIM, SIM, "lockstep", ""),
        (LIVE, "live-9", "live", "for session live-9"),
        (LIVE, SIM, "live", f"for session {SIM}"),
        (SIM, LIVE, "lockstep", f"for session {LIVE}"),
        # Without a token: only where nothing real moves.
        (LIVE, "", "live", "no session_token"),
        (SIM, "", "realtime", ""),
        # A receiver without one takes any of its kind.
        ("", LIVE, "live", ""),
        ("", SIM, "live", "is simulated"),
        ("", LIVE, "lockstep", "is live"),
        ("", "", "live", ""),
    ],
)
def test_a_command_is_for_one_session(own: str, given: str, mode: str, told: str) -> None:
    found = token_problem(own, given, mode)
    assert told in found
    assert bool(found) == bool(told)
