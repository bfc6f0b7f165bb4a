"""Commands of the manager to an object (ObjectCommand.srv), and when they are refused."""

from __future__ import annotations

from dataclasses import dataclass

from ssp_core.run_file.model import RunSpec
from ssp_ot_controller.core.object_machine import ObjectEvent

# Numbers of ObjectCommand.srv.
REFUSED_TRANSITION = 1
REFUSED_CONDITION = 2
REFUSED_VERSION = 3
# What the manager may ask for; the other events are for the object itself to notice.
COMMANDS = frozenset(
    {
        ObjectEvent.CONNECT,
        ObjectEvent.ARM,
        ObjectEvent.DISARM,
        ObjectEvent.START,
        ObjectEvent.STOP,
        ObjectEvent.ABORT,
        ObjectEvent.ALL_CLEAR,
    }
)


@dataclass(frozen=True, slots=True)
class Reply:
    """Answer to a command of the manager (ObjectCommand.srv)."""

    accepted: bool
    error_code: int = 0
    error_msg: str = ""


def cannot_arm(
    run: RunSpec, event_version: str, heartbeat_age_s: float, other_managers: int
) -> Reply | None:
    """Why an object can't be armed, None when nothing keeps it from that.

    Args:
        run: of the object.
        event_version: K* version of the manager's run.
        heartbeat_age_s: since the manager's last heartbeat, inf before the first.
        other_managers: how many managers beside ours send heartbeats.
    """
    ours, limit_s = run.event_version, run.limits.heartbeat_s
    if event_version != ours:
        return Reply(
            False,
            REFUSED_VERSION,
            f"this object has K* version {ours[:19]}..., the manager {event_version[:19]}...",
        )
    if not heartbeat_age_s <= limit_s:
        return Reply(
            False,
            REFUSED_CONDITION,
            f"no heartbeat of the manager for {heartbeat_age_s:.2g} s, limit {limit_s:g} s",
        )
    if other_managers:
        return Reply(
            False, REFUSED_CONDITION, f"{other_managers} other manager(s) send heartbeats too"
        )
    return None
