"""The silences that end a session: one table, which arming asks and watching judges by.

Arming asks for half of each limit, so that nothing is armed that the next look may end.
"""

from __future__ import annotations

from dataclasses import dataclass

from ssp_core import names
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import SessionPhase

# Arming asks for this share of each limit, at both ends.
ARMING_SHARE = 0.5
# Where limits are judged: from the arming of the objects to their standstill.
WATCHED = (SessionPhase.ARMED, SessionPhase.RUNNING, SessionPhase.STOPPING)
# A simulated world that is silent this long is taken for dead. In lockstep it may wait for a
# participant that died before it drops it, so that its silence means less; its camera's too.
WORLD_SILENT_LOCKSTEP_S = 12.0
WORLD_SILENT_REALTIME_S = 0.5
# A world that died must be named before the vehicle that it moved.
_AFTER_WORLD_S = 0.25
RECORDER_SILENT_S = 2.0
CAMERA_SILENT_S = 3.0
# The VUT's adapter; what it said last is forgotten.
ADAPTER_SILENT_S = 2.0


# Codes of the safety events that a silence is.
SILENCES = frozenset(
    {
        SafetyCode.WORLD_SILENT,
        SafetyCode.VUT_SILENT,
        SafetyCode.OBJECT_SILENT,
        SafetyCode.RECORDER,
        SafetyCode.PARTICIPANT_LOST,
        SafetyCode.REPLY_MISSING,
    }
)


@dataclass(frozen=True, slots=True)
class SignOfLife:
    """A participant that a session can't do without.

    Args:
        code: of the safety event that its silence is.
        who: node or object. An object's states (OBJECT_SILENT) and its answers to heartbeats
            (REPLY_MISSING) are two signs of one name.
        limit_s: the longest silence that a session bears, s, inclusive.
        phases: of the session, in which a longer one ends it.
        by_stamp: counted in session time from the stamp of the newest state; otherwise from its
            arrival, on the steady clock.
    """

    code: SafetyCode
    who: str
    limit_s: float
    phases: tuple[SessionPhase, ...] = WATCHED
    by_stamp: bool = False

    @property
    def arming_limit_s(self) -> float:
        """The longest silence on which a session is connected, armed or started, s, inclusive."""
        return ARMING_SHARE * self.limit_s


RECORDER_SIGN = SignOfLife(SafetyCode.RECORDER, names.MONITOR, RECORDER_SILENT_S)


def signs_of_life(spec: RunSpec) -> tuple[SignOfLife, ...]:
    """Return the table for a run.

    In lockstep an object's silence is counted in simulated time once the world steps, and answers
    to heartbeats, which come by the wall clock, end nothing; arming asks for them all the same.
    """
    lockstep, live = spec.mode == "lockstep", spec.mode == "live"
    world_s = WORLD_SILENT_LOCKSTEP_S if lockstep else WORLD_SILENT_REALTIME_S
    # The age of states is judged by their stamps; this is for stamps that can't be believed.
    state_s = max(world_s, spec.limits.state_age_s)
    stamp_s = spec.limits.state_age_s
    objects = [target.id for target in spec.targets]
    vut, silent = SafetyCode.VUT_SILENT, SafetyCode.OBJECT_SILENT
    table = []
    if not live:
        table.append(SignOfLife(SafetyCode.WORLD_SILENT, names.SIL_WORLD, world_s))
    table.append(SignOfLife(vut, names.VUT_ID, state_s if live else state_s + _AFTER_WORLD_S))
    while_held = (SessionPhase.ARMED,) if lockstep else WATCHED
    table += [SignOfLife(silent, who, state_s, while_held) for who in objects]
    table.append(RECORDER_SIGN)
    if spec.camera is not None:
        camera_s = world_s if lockstep else CAMERA_SILENT_S
        table.append(SignOfLife(SafetyCode.PARTICIPANT_LOST, names.FRONT_CAMERA, camera_s))
    answers, heartbeat_s = () if lockstep else WATCHED, spec.limits.heartbeat_s
    table += [SignOfLife(SafetyCode.REPLY_MISSING, who, heartbeat_s, answers) for who in objects]
    table.append(SignOfLife(vut, names.VUT_ID, stamp_s, by_stamp=True))
    table += [SignOfLife(silent, who, stamp_s, by_stamp=True) for who in objects]
    return tuple(table)


def lockstep_participants(spec: RunSpec) -> tuple[str, ...]:
    """List the nodes that a lockstep world waits for at first, the manager left out."""
    camera = (names.FRONT_CAMERA,) if spec.camera is not None else ()
    driver = (names.VUT_DRIVER,) if spec.has_driver_node else ()
    return names.OBJECT_TARGET, *camera, *driver, names.MONITOR
