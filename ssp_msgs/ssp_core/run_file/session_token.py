"""The token of a session: which session a goal, a command or a heartbeat is meant for.

``run.yaml`` holds it. It keeps sessions apart that reach each other by mistake. It is no secret
and no protection against a person who means harm (docs/safety.md).
"""

from __future__ import annotations

import secrets

_LIVE, _SIMULATED = "live", "sim"


def draw_token(mode: str) -> str:
    """Return a token for one session: what kind it is of, and a random part.

    Args:
        mode: of the run file.
    """
    return f"{_kind(mode)}-{secrets.token_hex(5)}"


def _kind(mode: str) -> str:
    return _LIVE if mode == "live" else _SIMULATED


def mode_problem(token: str, mode: str) -> str:
    """Say why a run of this mode isn't one of this session; empty where it is.

    Args:
        token: of the session; empty: of one without, which may be of any kind.
        mode: of the run file.
    """
    kind = token.partition("-")[0]
    if not token or kind == _kind(mode):
        return ""
    is_what = "live" if kind == _LIVE else "simulated"
    return f"session {token} is {is_what}, and the run's mode is {mode}"


def token_problem(own: str, command_token: str, mode: str) -> str:
    """Say why a command isn't for this session; empty where it is.

    Without a token of its own, a receiver takes any token of a session of its kind. A command
    without a token is taken in a simulated session alone, where nothing real moves.

    Args:
        own: token of the receiver's session; empty: it has none.
        command_token: that came with the command.
        mode: of the receiver's run file.
    """
    if command_token == own:
        return ""
    if not command_token:
        if _kind(mode) == _SIMULATED:
            return ""
        return (
            "the command carries no session_token, and this session is live; run.yaml holds its "
            "token, and the manager's log names it"
        )
    if not own:
        return mode_problem(command_token, mode)
    return f"the command is for session {command_token}, and this is session {own}"
