"""Numbers of the safety events (SafetyEvent.code), and what each one means."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class SafetyCode(IntEnum):
    """1 to 19 are seen by the object itself, 20 and up by the supervisor of the session."""

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


@dataclass(frozen=True, slots=True)
class SafetyMeaning:
    """What a code says.

    Args:
        limit_name: name of the predicate, as in SafetyEvent.limit_name.
        unit: unit of measured value and limit; empty for a count or a yes/no.
        text: one sentence for people.
    """

    limit_name: str
    unit: str
    text: str


MEANINGS: dict[SafetyCode, SafetyMeaning] = {
    SafetyCode.HEARTBEAT_LOST: SafetyMeaning(
        "heartbeat_lost", "s", "The manager's heartbeat stayed away; the object stops by itself."
    ),
    SafetyCode.STATE_STALE: SafetyMeaning(
        "state_stale", "s", "The object's own state is older than allowed."
    ),
    SafetyCode.STATE_NOT_FINITE: SafetyMeaning(
        "state_not_finite", "", "The object's own state holds a value that is no number."
    ),
    SafetyCode.OUTSIDE_GEOFENCE: SafetyMeaning(
        "outside_geofence", "m", "A corner of the object is outside the geofence, by this much."
    ),
    SafetyCode.OVER_SPEED: SafetyMeaning("over_speed", "m/s", "The object is too fast."),
    SafetyCode.OVER_ACCELERATION: SafetyMeaning(
        "over_acceleration", "m/s^2", "The object accelerates or brakes too hard."
    ),
    SafetyCode.ERROR_LONGITUDINAL: SafetyMeaning(
        "error_longitudinal", "m", "The object is too far ahead of or behind its reference."
    ),
    SafetyCode.ERROR_LATERAL: SafetyMeaning(
        "error_lateral", "m", "The object is too far beside its reference."
    ),
    SafetyCode.ERROR_YAW: SafetyMeaning(
        "error_yaw", "rad", "The object's heading is too far from its reference."
    ),
    SafetyCode.LOCALISATION: SafetyMeaning(
        "localisation", "m", "The stated uncertainty of the object's position is too large."
    ),
    SafetyCode.POSITION_JUMP: SafetyMeaning(
        "position_jump", "m", "A position is too far from where the state before it led."
    ),
    SafetyCode.STATE_FROZEN: SafetyMeaning(
        "state_frozen", "s", "New states arrive, but the position in them stands while it can't."
    ),
    SafetyCode.STOPPING_ROOM: SafetyMeaning(
        "stopping_room",
        "m",
        "Stopping any later would end outside the geofence, by this much at the worst.",
    ),
    SafetyCode.SEPARATION: SafetyMeaning(
        "separation", "m", "Two objects came closer than the minimum separation."
    ),
    SafetyCode.COLLISION: SafetyMeaning("collision", "m", "Two objects touch."),
    SafetyCode.OBJECT_SILENT: SafetyMeaning(
        "object_silent", "s", "No state arrived from an object target for too long."
    ),
    SafetyCode.VUT_SILENT: SafetyMeaning(
        "vut_silent", "s", "No state arrived from the vehicle under test for too long."
    ),
    SafetyCode.WORLD_SILENT: SafetyMeaning(
        "world_silent", "s", "The simulated world stopped stepping."
    ),
    SafetyCode.ACK_MISSING: SafetyMeaning(
        "ack_missing", "s", "A reference was not acknowledged in time."
    ),
    SafetyCode.REFERENCE_REFUSED: SafetyMeaning(
        "reference_refused", "", "An object refused a reference; measured is the refusal's number."
    ),
    SafetyCode.OBJECT_ABORTED: SafetyMeaning(
        "object_aborted",
        "",
        "An object went to ABORTING by itself, or left the run, and did not say why in time.",
    ),
    SafetyCode.DURATION: SafetyMeaning("duration", "s", "The run took longer than allowed."),
    SafetyCode.RECORDER: SafetyMeaning(
        "recorder", "", "The recorder lost messages or fell silent; measured is the number lost."
    ),
    SafetyCode.OPERATOR: SafetyMeaning("operator", "", "A person asked for the abort."),
    SafetyCode.PARTICIPANT_LOST: SafetyMeaning(
        "participant_lost", "s", "A node that the simulated world waits for stopped answering."
    ),
    SafetyCode.OVERRUN: SafetyMeaning(
        "overrun",
        "s",
        "The simulated world fell behind the wall clock in realtime mode, "
        "or the manager stood still.",
    ),
    SafetyCode.EVENT_MISSING: SafetyMeaning(
        "event_missing", "s", "The run's time is over and the event did not take place."
    ),
    SafetyCode.CLOCK_OFFSET: SafetyMeaning(
        "clock_offset", "s", "An object's clock and the manager's are too far apart."
    ),
    SafetyCode.LINK_DELAY: SafetyMeaning(
        "link_delay", "s", "A message to an object and its answer take too long."
    ),
    SafetyCode.REPLY_MISSING: SafetyMeaning(
        "reply_missing", "s", "An object did not answer the manager's heartbeats for too long."
    ),
    SafetyCode.FOREIGN_MANAGER: SafetyMeaning(
        "foreign_manager",
        "",
        "Another node publishes what one alone may, as heartbeats; measured is how many do.",
    ),
}
