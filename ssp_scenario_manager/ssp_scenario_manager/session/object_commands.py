"""Commands to objects until they are answered: which to send, when again, and when to give up."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_scenario_manager.session.outbox import ObjectCommand

# An answer that hasn't come by now may be lost.
REPEAT_S = 0.5
# An object arms when it is asked to, or not at all.
ARM_WAIT_S = 3.0
# A clearing that comes later than this may meet an object that something new has stopped.
CLEAR_WAIT_S = 2.0
_WAIT_S = {ObjectCommand.ARM: ARM_WAIT_S, ObjectCommand.ALL_CLEAR: CLEAR_WAIT_S}


@dataclass(slots=True)
class Pending:
    """A command that an object has not answered yet.

    Args:
        event_version: K* version of the run.
        rules_digest: of what the object judges by, for an ARM.
        abort_id: of the abort that an ALL_CLEAR clears.
        request_ns: when the session gave it, on the steady clock.
        sent_ns: when it was sent last; None: its service isn't there yet.
        refusal: what the object answered last, and will be asked again.
    """

    object_id: str
    command: ObjectCommand
    event_version: str
    rules_digest: str
    abort_id: str
    request_ns: int
    sent_ns: int | None = None
    refusal: str = ""

    @property
    def outcome(self) -> str:
        """Describe the outcome of a command that is given up, with the object as the subject."""
        if self.refusal:
            return f"refused: {self.refusal}"
        if self.sent_ns is None:
            return f"has no command service to {self.command.name.lower()} it by"
        return f"did not answer {self.command.name.lower()}"

    def is_due(self, steady_ns: int) -> bool:
        """Tell whether it was not sent yet, or may be sent again."""
        if self.sent_ns is None:
            return True
        again = steady_ns - self.sent_ns >= seconds_to_ns(REPEAT_S)
        return again and self.command is not ObjectCommand.ARM

    def is_overdue(self, steady_ns: int) -> bool:
        """Tell whether its time is over; arming is watched by the session itself."""
        is_sent_arm = self.command is ObjectCommand.ARM and self.sent_ns is not None
        wait_s = _WAIT_S.get(self.command)
        if is_sent_arm or wait_s is None:
            return False
        return ns_to_seconds(steady_ns - self.request_ns) > wait_s


class ObjectCommands:
    """The pending commands, at most one per object: a newer one takes the place of what waits.

    A disarm is repeated until it is answered. An all-clear is repeated until it is accepted, for
    CLEAR_WAIT_S at most. An arm is sent once. Each waits until the object's service is there.
    """

    def __init__(self) -> None:
        self._pending: dict[str, Pending] = {}

    def ask(
        self,
        rules_digests: Mapping[str, str],
        command: ObjectCommand,
        event_version: str,
        abort_id: str,
        steady_ns: int,
    ) -> None:
        """Take a command for some objects, given with the digests of their rules."""
        for object_id, digest in rules_digests.items():
            one = Pending(object_id, command, event_version, digest, abort_id, steady_ns)
            self._pending[object_id] = one

    def forget_for_abort(self) -> None:
        """Forget all-clears of the abort before, and arms that wait: there is a new abort.

        An arm that was sent isn't sent again; its answer may still say why the object refuses.
        """
        for object_id, one in list(self._pending.items()):
            waits_to_arm = one.command is ObjectCommand.ARM and one.sent_ns is None
            if waits_to_arm or one.command is ObjectCommand.ALL_CLEAR:
                del self._pending[object_id]

    def due(self, is_there: Callable[[str], bool], steady_ns: int) -> list[Pending]:
        """Return the commands to send now; they count as sent.

        Args:
            is_there: tells whether an object's command service is there.
            steady_ns: now, on the steady clock.
        """
        due_commands = []
        for one in self._pending.values():
            if one.is_due(steady_ns) and is_there(one.object_id):
                one.sent_ns = steady_ns
                due_commands.append(one)
        return due_commands

    def overdue(self, steady_ns: int) -> list[Pending]:
        """Return commands that are given up now, each once."""
        overdue_commands = [one for one in self._pending.values() if one.is_overdue(steady_ns)]
        for one in overdue_commands:
            del self._pending[one.object_id]
        return overdue_commands

    def on_answer(self, request: Pending, accepted: bool, error_msg: str) -> bool:
        """Take an answer; return False for one to a command that isn't awaited any more.

        A refused all-clear is asked again: the object may not have heard of the abort yet.
        """
        if self._pending.get(request.object_id) is not request:
            return False
        if request.command is ObjectCommand.ALL_CLEAR and not accepted:
            request.refusal = error_msg
        else:
            del self._pending[request.object_id]
        return True

    def all_sent(self, command: ObjectCommand) -> bool:
        """Tell whether no command of this kind waits for a service."""
        return all(
            one.sent_ns is not None for one in self._pending.values() if one.command is command
        )
