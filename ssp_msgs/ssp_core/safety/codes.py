"""Numbers of the safety events (SafetyEvent.code), and what each one means."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class SafetyCode(IntEnum):
    """Names of limits that may be passed; docs/safety.md has a table of who judges which."""

    HEARTBEAT_LOST = 1
    STATE_STALE = 2
    STATE_NOT_FINITE = 3
    OUTSIDE_GEOFENCE = 4
    OVER_SPEED = 5
    OVER_ACCELERATION = 6
    ERROR_LONGITUDINAL = 7
    ERROR_LATERAL = 8
    ERROR_YAW = 9
    LOCALISATION = 10
    POSITION_JUMP = 11
    STATE_FROZEN = 12
    STOPPING_ROOM = 13
    SEPARATION = 20
    COLLISION = 21
    OBJECT_SILENT = 22
    VUT_SILENT = 23
    WORLD_SILENT = 24
    ACK_MISSING = 25
    REFERENCE_REFUSED = 26
    OBJECT_ABORTED = 27
    DURATION = 28
    RECORDER = 29
    OPERATOR = 30
    PARTICIPANT_LOST = 31
    OVERRUN = 32
    EVENT_MISSING = 33
    CLOCK_OFFSET = 34
    LINK_DELAY = 35
    REPLY_MISSING = 36
    FOREIGN_MANAGER = 37
    NOT_STOPPING = 38
    OBJECT_CONTRADICTS = 39
    CONNECTION_LOST = 40
    STATE_CONTRADICTS = 41


@dataclass(frozen=True, slots=True)
class SafetyMeaning:
    """The meaning of a code.

    Args:
        limit_name: name of the predicate, as in SafetyEvent.limit_name.
        unit: unit of measured value and limit; empty for a count or a yes/no.
        text: one sentence for people.
    """

    limit_name: str
    unit: str
    text: str


_MEANT: dict[SafetyCode, tuple[str, str]] = {
    SafetyCode.HEARTBEAT_LOST: (
        "s",
        "No heartbeat from the manager arrived in time; the object stops by itself.",
    ),
    SafetyCode.STATE_STALE: ("s", "The object's own state is older than allowed."),
    SafetyCode.STATE_NOT_FINITE: ("", "The object's own state holds a value that isn't finite."),
    SafetyCode.OUTSIDE_GEOFENCE: (
        "m",
        "Part of the object, or of its path here, is outside the geofence, by this much.",
    ),
    SafetyCode.OVER_SPEED: ("m/s", "The object is too fast."),
    SafetyCode.OVER_ACCELERATION: ("m/s^2", "The object accelerates or brakes too hard."),
    SafetyCode.ERROR_LONGITUDINAL: ("m", "The object is too far ahead of or behind its reference."),
    SafetyCode.ERROR_LATERAL: ("m", "The object is too far beside its reference."),
    SafetyCode.ERROR_YAW: ("rad", "The object's heading is too far from its reference."),
    SafetyCode.LOCALISATION: ("m", "The stated uncertainty of the object's position is too large."),
    SafetyCode.POSITION_JUMP: ("m", "A position is too far from where the previous state led."),
    SafetyCode.STATE_FROZEN: (
        "s",
        "New states arrive with the same position while the stated or commanded speed isn't zero.",
    ),
    SafetyCode.STOPPING_ROOM: (
        "m",
        "Stopping any later would lead outside the geofence, by up to this much.",
    ),
    SafetyCode.SEPARATION: ("m", "Two objects came closer than the minimum separation."),
    SafetyCode.COLLISION: ("m", "Two objects touch."),
    SafetyCode.OBJECT_SILENT: ("s", "No state arrived from an object target for too long."),
    SafetyCode.VUT_SILENT: ("s", "No state arrived from the vehicle under test for too long."),
    SafetyCode.WORLD_SILENT: ("s", "The simulated world stopped stepping."),
    SafetyCode.ACK_MISSING: ("s", "A reference was not acknowledged in time."),
    SafetyCode.REFERENCE_REFUSED: (
        "",
        "An object refused a reference; measured is the refusal's number.",
    ),
    SafetyCode.OBJECT_ABORTED: (
        "",
        "An object went to ABORTING by itself, or left the run, and did not report why in time.",
    ),
    SafetyCode.DURATION: ("s", "The run took longer than allowed."),
    SafetyCode.RECORDER: (
        "",
        "The recorder lost messages or fell silent; measured is the number lost.",
    ),
    SafetyCode.OPERATOR: ("", "A person requested the abort."),
    SafetyCode.PARTICIPANT_LOST: (
        "s",
        "A node that the simulated world waits for stopped answering.",
    ),
    SafetyCode.OVERRUN: (
        "s",
        "The simulated world fell behind the wall clock in realtime mode, or the manager stalled.",
    ),
    SafetyCode.EVENT_MISSING: ("s", "The run's time is over and the event did not take place."),
    SafetyCode.CLOCK_OFFSET: ("s", "An object's clock and the manager's are too far apart."),
    SafetyCode.LINK_DELAY: ("s", "A message to an object and its answer take too long."),
    SafetyCode.REPLY_MISSING: (
        "s",
        "An object did not answer the manager's heartbeats for too long.",
    ),
    SafetyCode.FOREIGN_MANAGER: (
        "",
        "Another node publishes what only one may, such as heartbeats; measured is their number.",
    ),
    SafetyCode.NOT_STOPPING: (
        "s",
        "A test object was commanded to stop and did not slow down for this long.",
    ),
    SafetyCode.OBJECT_CONTRADICTS: (
        "",
        "A test object reports a state that contradicts the session's; measured is its number.",
    ),
    SafetyCode.CONNECTION_LOST: (
        "",
        "The control connection to a test object was lost while it was armed or running.",
    ),
    SafetyCode.STATE_CONTRADICTS: (
        "s",
        "Stated speed, direction or yaw contradicts the positions without a break for this long; "
        "or class or extent differs from the previous state's.",
    ),
}
MEANINGS = {code: SafetyMeaning(code.name.lower(), *meant) for code, meant in _MEANT.items()}
