"""Commands to objects: sent once they can be heard, repeated where an answer may be lost."""

from __future__ import annotations

import pytest

from ssp_scenario_manager.session.object_commands import (
    ARM_WAIT_S,
    CLEAR_WAIT_S,
    REPEAT_S,
    ObjectCommands,
    Pending,
)
from ssp_scenario_manager.session.outbox import ObjectCommand

MS = 1_000_000
ARM, DISARM, CLEAR = ObjectCommand.ARM, ObjectCommand.DISARM, ObjectCommand.ALL_CLEAR


def pending_commands(command: ObjectCommand, at_ms: int = 0) -> ObjectCommands:
    commands = ObjectCommands()
    commands.ask({"ot1": "sha256:rules"}, command, "sha256:event", "m/1", at_ms * MS)
    return commands


def due(commands: ObjectCommands, at_ms: int, there: bool = True) -> list[Pending]:
    return commands.due(lambda _: there, at_ms * MS)


@pytest.mark.parametrize("command", ObjectCommand)
def test_a_command_waits_until_the_service_is_there(command: ObjectCommand) -> None:
    commands = pending_commands(command)
    assert due(commands, 1900, there=False) == []
    assert not commands.all_sent(command)
    (one,) = due(commands, 1950)
    assert (one.object_id, one.command, one.abort_id) == ("ot1", command, "m/1")
    assert one.rules_digest == "sha256:rules"
    assert commands.all_sent(command)
    assert commands.on_answer(one, True, "")
    assert due(commands, 9000) == []


def test_a_lost_disarm_is_repeated_until_it_is_answered() -> None:
    commands = pending_commands(DISARM)
    (one,) = due(commands, 0)
    for at_ms in range(500, 60_000, 500):
        assert due(commands, at_ms - 1) == []
        assert due(commands, at_ms) == [one]
        assert commands.overdue(at_ms * MS) == []
    assert REPEAT_S == 0.5
    # Also a refusal is an answer: it is DISARMED already.
    assert commands.on_answer(one, False, "DISARM is not possible in DISARMED")
    assert due(commands, 99_000) == []


def test_an_all_clear_is_repeated_for_two_seconds_at_most() -> None:
    commands = pending_commands(CLEAR)
    (one,) = due(commands, 0)
    assert commands.on_answer(one, False, "another abort than that stops it")
    assert due(commands, 500) == [one]
    assert commands.overdue(2000 * MS) == []
    assert CLEAR_WAIT_S == 2.0
    assert commands.overdue(2001 * MS) == [one]
    assert one.outcome == "refused: another abort than that stops it"
    assert commands.overdue(2002 * MS) == due(commands, 2002) == []
    # An answer that comes after all changes nothing.
    assert not commands.on_answer(one, True, "")


def test_a_new_abort_ends_the_clearing_of_the_one_before() -> None:
    commands = pending_commands(CLEAR)
    (one,) = due(commands, 0)
    commands.forget_for_abort()
    assert due(commands, 600) == []
    assert not commands.on_answer(one, True, "")


def test_an_arm_that_waits_for_a_service_ends_with_an_abort() -> None:
    """It would arm an object that no session is going to lead."""
    commands = pending_commands(ARM)
    assert due(commands, 100, there=False) == []
    commands.forget_for_abort()
    assert due(commands, 200) == commands.overdue(9000 * MS) == []
    assert commands.all_sent(ARM)
    # One that was sent may still be refused, with its reason.
    commands = pending_commands(ARM)
    (one,) = due(commands, 0)
    commands.forget_for_abort()
    assert due(commands, 9000) == []
    assert commands.on_answer(one, False, "no probe report")


def test_an_abort_leaves_a_disarm_that_waits() -> None:
    commands = pending_commands(DISARM)
    commands.forget_for_abort()
    assert len(due(commands, 0)) == 1


def test_an_arm_is_sent_once_and_given_up_where_it_could_not_be_heard() -> None:
    commands = pending_commands(ARM)
    assert len(due(commands, 100)) == 1
    assert due(commands, 5000) == commands.overdue(5000 * MS) == []
    commands = pending_commands(ARM)
    assert due(commands, 3000, there=False) == commands.overdue(3000 * MS) == []
    assert ARM_WAIT_S == 3.0
    (one,) = commands.overdue(3001 * MS)
    assert one.outcome == "has no command service to arm it by"
    assert commands.all_sent(ARM)


def test_a_newer_command_takes_the_place_of_what_waits() -> None:
    commands = pending_commands(DISARM)
    (old,) = due(commands, 0)
    commands.ask({"ot1": "sha256:rules"}, ARM, "sha256:event", "", 100 * MS)
    (new,) = due(commands, 100)
    assert new.command is ARM
    assert not commands.on_answer(old, True, "")
    assert due(commands, 9000) == []


@pytest.mark.parametrize(
    ("command", "wait_s"), [(ARM, ARM_WAIT_S), (CLEAR, CLEAR_WAIT_S), (DISARM, None)]
)
def test_a_command_is_given_up_so_long_after_it_was_asked_for(
    command: ObjectCommand, wait_s: float | None
) -> None:
    """The steady clock is older than the command."""
    commands = pending_commands(command, 60_000)
    latest_ms = 60_000 + round(1000 * (wait_s or 9.0))
    assert commands.overdue(latest_ms * MS) == []
    overdue = commands.overdue((latest_ms + 1) * MS)
    assert [one.object_id for one in overdue] == ([] if wait_s is None else ["ot1"])


def test_each_object_is_sent_its_command_once_its_own_service_is_there() -> None:
    commands = ObjectCommands()
    digests = {"ot1": "sha256:a", "ot2": "sha256:b"}
    commands.ask(digests, ARM, "sha256:event", "", 0)
    (first,) = commands.due(lambda object_id: object_id == "ot2", 100 * MS)
    (second,) = due(commands, 200)
    for one, object_id in ((first, "ot2"), (second, "ot1")):
        assert (one.object_id, one.rules_digest) == (object_id, digests[object_id])
        # An object arms for no other K*.
        assert one.event_version == "sha256:event"
