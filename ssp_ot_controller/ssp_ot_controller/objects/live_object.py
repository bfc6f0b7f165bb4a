"""One object with a body of hardware: its newest believable reading, and when it is stepped.

This file owns what the body said; a reading that isn't believed changes nothing but the reason.
Reads no clock.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from ssp_core.clock import ns_to_seconds
from ssp_core.leap_seconds import leap_seconds
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.safety.body_status import BodyStatus
from ssp_ot_controller.bodies.body import Body, BodyCheck, BodyReading, state_of
from ssp_ot_controller.bodies.dynamics import Command
from ssp_ot_controller.bodies.iso22133.gateway import IsoBody

# Until a body is heard for the first time it is told to stand; it sends to whoever commands it.
_STAND = Command(0.0, 0.0, 0.0, emergency_stop=True)
# An object without a new reading for so long has none.
_QUIET_S = 0.5
# A clock that is as many seconds ahead as GPS time, to this, was not given the leap seconds.
_NEAR_S = 0.5


@dataclass(frozen=True, slots=True)
class ReadingLimits:
    """The limits of readings, and when an object is stepped on them, s.

    Args:
        ahead_s: a stamp may lie so far ahead.
        oldest_s: a reading may be so old when it comes.
        apart_s: between two steps of an object, at the least.
        silent_s: an object that reports is stepped without a new reading after so long.
    """

    ahead_s: float
    oldest_s: float
    apart_s: float
    silent_s: float


def _leap_hint(off_s: float, now_ns: int, hint: str) -> str:
    """Return a word on leap seconds, where a clock is off by as many."""
    return f" ({hint})" if abs(off_s - leap_seconds(now_ns)) < _NEAR_S else ""


class LiveObject:
    """A body of one process, as an object of the run.

    Args:
        spec: of the object.
        no_room: why the object must not drive its approach, as sentences; empty where it may.
    """

    def __init__(
        self,
        body: Body,
        spec: ParticipantSpec,
        limits: ReadingLimits,
        no_room: tuple[str, ...] = (),
    ) -> None:
        self.body = body
        self._no_room = no_room
        self._spec = spec
        self._limits = limits
        self._newest: BodyReading | None = None
        self._reading_ns = 0
        self._late_s = 0.0  # how old the newest reading was when it was taken
        self._stepped_ns = 0
        self._states = 0
        # Why the newest reading isn't taken: it came from the future.
        self._ahead = ""
        self._has_warned = False

    def read(self, now_ns: int) -> str:
        """Take the newest reading.

        Returns:
            Why it isn't taken, the first time; empty otherwise.
        """
        reading = self.body.read()
        if reading is None:
            return ""
        self._ahead = self._refusal(reading, now_ns)
        if not self._ahead:
            self._newest, self._reading_ns = reading, now_ns
            self._late_s = ns_to_seconds(now_ns - reading.stamp_ns)
            return ""
        warns, self._has_warned = not self._has_warned, True
        return self._ahead if warns else ""

    def _refusal(self, reading: BodyReading, now_ns: int) -> str:
        ahead_s = ns_to_seconds(reading.stamp_ns - now_ns)
        if ahead_s <= self._limits.ahead_s:
            return ""
        text = (
            f"its body's clock is {ahead_s:.3f} s ahead, limit {self._limits.ahead_s:g} s: its "
            "readings aren't taken"
        )
        return text + _leap_hint(ahead_s, now_ns, "GPS time is so far ahead of UTC")

    def step(self, now_ns: int, *, only_new: bool) -> ObjectState | None:
        """Return the object's state, if it is stepped now; one without news is where it was.

        Args:
            now_ns: by this host's clock.
            only_new: an object that says nothing new isn't stepped.
        """
        reading = self._newest
        if reading is None or not self._is_due(now_ns, only_new=only_new):
            return None
        self._stepped_ns = now_ns
        self._states += 1
        return state_of(reading, self._spec, self._states)

    def _is_due(self, now_ns: int, *, only_new: bool) -> bool:
        if now_ns < self._stepped_ns:
            # The clock was set back: what is stamped ahead of it now is for the object to judge.
            return not only_new
        if ns_to_seconds(now_ns - self._stepped_ns) < self._limits.apart_s:
            return False
        if self._reading_ns > self._stepped_ns:
            return True
        reports = isinstance(self.body, IsoBody)
        is_silent = not reports or ns_to_seconds(now_ns - self._reading_ns) > self._limits.silent_s
        return is_silent and not only_new

    def command(self, command: Command | None, now_ns: int) -> None:
        """Send a command; a body that was never heard is commanded to stand."""
        if command is None and self._newest is None:
            command = _STAND
        if command is not None:
            self.body.command(command if command.is_finite else _STAND, now_ns)

    # -- what is wrong -------------------------------------------------------------------------

    @property
    def check(self) -> BodyCheck:
        """Return the judgement of a body with a control state of its own, and of its stops."""
        if not isinstance(self.body, IsoBody):
            return BodyCheck()
        check = self.body.check
        return replace(
            check,
            cannot_arm=(*check.cannot_arm, *self._no_room),
            lasting=check.lasting or bool(self._no_room),
            slows_s=self.body.slows_s,
        )

    def status(self, now_ns: int) -> BodyStatus:
        """Report what keeps the object from being seen and armed."""
        silent = self._newest is None or ns_to_seconds(now_ns - self._reading_ns) > _QUIET_S
        problems = (self._ahead,) if self._ahead else self.body.problems()
        by_itself = isinstance(self.body, IsoBody)
        check = self.check
        late = () if silent else self._late(now_ns)
        deaf = () if silent or by_itself else self._deaf()
        no_state = problems if silent else ()
        keeps = (*check.cannot_arm, *late, *deaf)
        return BodyStatus(self._spec.id, no_state, keeps, check.lasting)

    def _deaf(self) -> tuple[str, ...]:
        """Say that a body hears no command, where it says so; empty otherwise.

        One of ISO 22133 says it by its state.
        """
        if self._newest is None or not self._newest.brakes_by_itself:
            return ()
        return (
            "its body hears no command and brakes by itself: is the way to it open, and does no "
            "other program command it?",
        )

    def _late(self, now_ns: int) -> tuple[str, ...]:
        """Say why the newest reading was too old when it came."""
        late_s, oldest_s = self._late_s, self._limits.oldest_s
        if late_s <= oldest_s:
            return ()
        text = (
            f"its body's readings are {late_s:.3f} s old on arrival, limit {oldest_s:g} s: "
            "its clock is behind, or its link is slow"
        )
        return (text + _leap_hint(late_s, now_ns, "UTC is so far behind GPS time"),)
