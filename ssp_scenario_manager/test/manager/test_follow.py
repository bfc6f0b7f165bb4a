"""The end of a session when one of its processes dies."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from unittest.mock import MagicMock

import pytest

from ssp_core import names
from ssp_core.run_file.model import Fault, RunSpec
from ssp_core.vocabulary import SessionPhase, Verdict
from ssp_scenario_manager.ros import runner_client
from ssp_scenario_manager.ros.runner_client import StepwiseClient
from ssp_scenario_manager.run.over_dds import follow
from ssp_scenario_manager.run.over_dds.word import TypedWords
from ssp_scenario_manager.session.run_script import RunOutcome

SPINS = 300


def dead(name: str) -> MagicMock:
    node = MagicMock()
    node.name = name
    node.describe_exit.return_value = "exited with status 1"
    node.log_tail.return_value = "datum: isn't there"
    return node


def quiet_client(*, was_armed: bool) -> MagicMock:
    """A client that hears its manager, and nothing else."""
    client = MagicMock(silent_s=0.0, under_way=False, not_in_time=None)
    client.other_managers.return_value = ()
    client.session.trouble = client.session.first_event = None
    client.session.was_armed = was_armed
    client.session.times.session_s = client.session.times.wall_s = 0.0
    return client


def replace_session(
    monkeypatch: pytest.MonkeyPatch, client: MagicMock, typed: int, clock: MagicMock
) -> None:
    """Give the terminal that follows a session this client, what is typed there, and a clock."""
    for name, value in (
        ("RunClient", lambda *_, **__: client),
        ("StartListener", MagicMock()),
        ("TypedWords", lambda: TypedWords(typed)),
        ("summary", lambda *_: ["who is connected"]),
        ("connected", lambda *_: {}),
        ("PromptFacts", lambda *_: MagicMock(news=MagicMock(return_value=[]))),
        ("time", clock),
    ):
        monkeypatch.setattr(follow, name, value)


@pytest.mark.parametrize("armed", [False, True])
def test_a_process_that_dies_before_anything_is_armed_ends_the_session_at_once(
    run: RunSpec, monkeypatch: pytest.MonkeyPatch, armed: bool
) -> None:
    """The session has time to come to stand if something was armed."""
    node = dead(names.OBJECT_TARGET)
    group = MagicMock(processes={names.OBJECT_TARGET: node, names.SCENARIO_MANAGER: MagicMock()})
    client = quiet_client(was_armed=armed)
    client.outcome = None
    # It comes up, and ends when the run has begun.
    group.ended.side_effect = lambda: [node] if client.begin.called else []

    def spin(timeout_s: float) -> None:
        if client.spin.call_count > SPINS:
            raise TimeoutError

    client.spin.side_effect = spin
    monkeypatch.setattr(follow, "RunClient", lambda *_, **__: client)
    monkeypatch.setattr(follow, "END_TIMEOUT_S", 1e6)

    def followed() -> follow.SessionOutcome:
        return follow.follow(
            run, group, Path("run.yaml"), Path("bag"), MagicMock(), follow.Interrupt()
        )

    if armed:
        with pytest.raises(TimeoutError):
            followed()
        assert not client.cancel.called
        return
    outcome = followed().outcome
    # What hangs there must not keep the session's processes alive.
    assert not client.close.called
    group.after_end.callback.assert_called_once_with(client.close)
    assert outcome.verdict is Verdict.INVALID_HARNESS
    assert "exited with status 1" in outcome.reasons[0]
    assert client.cancel.called
    assert client.spin.call_count < 5


class Truth:
    """Messages of a world in which nothing stands, on the clock of a test.

    Args:
        lives: it tells of itself until the end.
    """

    def __init__(self, now_s: list[float], *, lives: bool) -> None:
        self._now_s, self._lives = now_s, lives
        self._began_s = now_s[0]

    @property
    def wall_s(self) -> float:
        return self._now_s[0]

    def newest_truth_s(self) -> float:
        return self._now_s[0] if self._lives else self._began_s

    def all_stand(self) -> bool:
        return False


@pytest.mark.parametrize(
    ("mode", "lives"), [("live", False), ("live", True), ("lockstep", False), ("lockstep", True)]
)
@pytest.mark.parametrize("silent", [False, True])
def test_a_manager_that_lives_and_gives_no_result_doesnt_keep_the_run(
    run: RunSpec, monkeypatch: pytest.MonkeyPatch, silent: bool, mode: str, lives: bool
) -> None:
    """The verdict comes within half a minute, even if a clock that was set delays the result.

    Nor does a world that never stands.
    """
    now_s = [100.0]
    manager = MagicMock()
    world = {names.SIL_WORLD: MagicMock(returncode=None)} if mode == "lockstep" else {}
    group = MagicMock(processes={names.SCENARIO_MANAGER: manager, **world})
    group.ended.return_value = []
    client = quiet_client(was_armed=True)
    client.outcome = None

    def spin(timeout_s: float) -> None:
        now_s[0] += timeout_s
        if now_s[0] >= 140.0 and silent:
            client.silent_s = now_s[0] - 140.0
        elif now_s[0] >= 140.0 and client.session.trouble is None:
            client.session.trouble = now_s[0], "clock_offset ot1: -5 s, limit 0.05 s"
        assert now_s[0] < 180.0, "the run was not ended in time"

    client.spin.side_effect = spin
    monkeypatch.setattr(follow, "RunClient", lambda *_, **__: client)
    monkeypatch.setattr(follow, "FaultEndpoints", lambda *_: Truth(now_s, lives=lives))
    monkeypatch.setattr(follow, "time", MagicMock(monotonic=lambda: now_s[0]))
    outcome = follow.follow(
        run.model_copy(update={"mode": mode}),
        group,
        Path("run.yaml"),
        Path("bag"),
        MagicMock(),
        follow.Interrupt(),
    ).outcome
    since_s = follow.SILENT_S if silent else follow.RESULT_S
    assert since_s <= now_s[0] - 140.0 < 29.0
    assert manager.kill.called
    assert outcome.verdict is Verdict.INVALID_HARNESS
    assert outcome.reasons == (
        "scenario_manager silent for 10 s"
        if silent
        else "scenario_manager gave no result 25 s after clock_offset ot1: -5 s, limit 0.05 s",
    )


def test_what_is_typed_while_the_summary_appears_starts_nothing(
    run: RunSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A terminal that is stopped (Ctrl-S) shows summary and prompt only after what was typed."""
    now_s = [100.0]
    read, write = os.pipe()
    group = MagicMock()
    group.ended.return_value = []
    client = quiet_client(was_armed=False)
    client.loaded = ()
    prompted_s: list[float] = []

    def spin(timeout_s: float) -> None:
        now_s[0] += timeout_s
        if prompted_s and now_s[0] > prompted_s[0] + 2.0:
            os.write(write, b"abort\n")

    def say(line: str) -> None:
        if line == "who is connected":
            os.write(write, b"start\n")
        elif line == follow.PROMPT:
            prompted_s.append(now_s[0])

    client.spin.side_effect = spin
    clock = MagicMock(monotonic=lambda: now_s[0], monotonic_ns=lambda: round(now_s[0] * 1e9))
    replace_session(monkeypatch, client, read, clock)
    live = MagicMock(start_at_once=False, remappings=())
    try:
        outcome = follow.follow(
            run, group, Path("run.yaml"), Path("bag"), say, follow.Interrupt(), live
        ).outcome
    finally:
        os.close(read)
        os.close(write)
    assert outcome.reasons == ("abort before the start",)
    assert not client.begin.called


@pytest.mark.parametrize("unread", ["who is connected", follow.PROMPT])
def test_a_word_starts_nothing_while_the_terminal_is_stopped_before_the_prompt(
    run: RunSpec, monkeypatch: pytest.MonkeyPatch, unread: str
) -> None:
    read, write = os.pipe()
    group, said = MagicMock(), list[str]()
    group.ended.return_value = []
    client = quiet_client(was_armed=False)
    client.loaded, now_ns = (), [0]

    def spin(timeout_s: float) -> None:
        now_ns[0] += round(timeout_s * 1e9)
        if unread in said and client.spin.call_count % 20 == 0:
            os.write(write, b"start\n" if client.spin.call_count < SPINS else b"abort\n")

    client.spin.side_effect = spin
    clock = MagicMock(monotonic=lambda: now_ns[0] / 1e9, monotonic_ns=lambda: now_ns[0])
    replace_session(monkeypatch, client, read, clock)
    live = MagicMock(start_at_once=False, remappings=())

    def mark() -> Callable[[], bool]:
        last = said[-1] if said else ""
        return lambda: last != unread

    given = (Path("run.yaml"), Path("bag"), said.append, follow.Interrupt(), live)
    try:
        outcome = follow.follow(run, group, *given, mark).outcome
    finally:
        os.close(read)
        os.close(write)
    assert outcome.reasons == ("abort before the start",)
    assert not client.begin.called
    assert (follow.PROMPT in said) is (unread == follow.PROMPT)


@pytest.mark.parametrize("start_at_once", [True, False])
def test_an_abort_that_is_typed_while_the_session_comes_up_ends_it_before_anything_is_asked(
    run: RunSpec, monkeypatch: pytest.MonkeyPatch, start_at_once: bool
) -> None:
    read, write = os.pipe()
    group = MagicMock()
    group.ended.return_value = []
    client = quiet_client(was_armed=False)
    client.outcome = RunOutcome(Verdict.VALID, ())
    client.lacks.side_effect = lambda: [] if client.spin.call_count > 5 else ["the manager"]
    monkeypatch.setattr(follow, "RunClient", lambda *_, **__: client)
    monkeypatch.setattr(follow, "TypedWords", lambda: TypedWords(read))
    live = MagicMock(start_at_once=start_at_once, remappings=())
    os.write(write, b"abort\n")
    try:
        outcome = follow.follow(
            run, group, Path("run.yaml"), Path("bag"), MagicMock(), follow.Interrupt(), live
        ).outcome
    finally:
        os.close(read)
        os.close(write)
    assert (outcome.verdict, outcome.reasons) == (Verdict.ABORTED, ("abort before the start",))
    assert not client.begin.called
    assert not client.load.called


@pytest.mark.parametrize("noticed", [True, False])
def test_an_abort_that_is_under_way_has_its_own_time_for_the_result(
    run: RunSpec, monkeypatch: pytest.MonkeyPatch, noticed: bool
) -> None:
    """A world waits 10 s for who died, and a manager as long for a standstill: 20 s in all."""
    now_s = [100.0]
    node = dead(names.OBJECT_TARGET)
    group = MagicMock(processes={names.OBJECT_TARGET: node, names.SCENARIO_MANAGER: MagicMock()})
    group.ended.side_effect = lambda: [node] if now_s[0] >= 110.0 else []
    client = quiet_client(was_armed=True)
    client.outcome = None
    lost = "participant_lost: object_target: 10.1 s, limit 10 s"

    def spin(timeout_s: float) -> None:
        now_s[0] += timeout_s
        if noticed and now_s[0] >= 120.0:
            client.session.trouble = 120.0, lost
        if noticed and now_s[0] >= 131.0:
            client.outcome = RunOutcome(Verdict.INVALID_HARNESS, (lost,))

    client.spin.side_effect = spin
    monkeypatch.setattr(follow, "RunClient", lambda *_, **__: client)
    monkeypatch.setattr(follow, "time", MagicMock(monotonic=lambda: now_s[0]))
    outcome = follow.follow(
        run, group, Path("run.yaml"), Path("bag"), MagicMock(), follow.Interrupt()
    ).outcome
    assert outcome.verdict is Verdict.INVALID_HARNESS
    told = outcome.reasons[-1]
    assert told.startswith("object_target exited with status 1")
    assert outcome.reasons == ((lost, told) if noticed else (told,))
    assert now_s[0] == pytest.approx(131.0 if noticed else 130.0, abs=0.2)


@pytest.mark.parametrize(("world_lives", "ends_s"), [(True, 13.0), (False, 2.2)])
def test_objects_that_lost_their_manager_stop_however_long_a_world_in_lockstep_waits_for_it(
    run: RunSpec, monkeypatch: pytest.MonkeyPatch, world_lives: bool, ends_s: float
) -> None:
    """A saturated machine takes ten seconds to drop the killed process, and goes on then."""
    now_s, died_s = [100.0], 101.0
    world = MagicMock(returncode=None if world_lives else 1)
    manager = dead(names.SCENARIO_MANAGER)
    group = MagicMock(processes={names.SIL_WORLD: world, names.SCENARIO_MANAGER: manager})
    group.ended.side_effect = lambda: [manager] if now_s[0] >= died_s else []
    client = quiet_client(was_armed=True)
    client.outcome = None

    class Truth:
        """A world that is silent for ten seconds, and then brakes for two seconds."""

        wall_s = property(lambda _: now_s[0])

        def __init__(self, *_: object) -> None:
            self.began_s = now_s[0]

        def newest_truth_s(self) -> float:
            return now_s[0] if world_lives and now_s[0] > died_s + 10.1 else died_s

        def all_stand(self) -> bool:
            return world_lives and now_s[0] >= died_s + 12.1

    def spin(timeout_s: float) -> None:
        now_s[0] += timeout_s
        assert now_s[0] < 200.0, "the run was not ended"

    client.spin.side_effect = spin
    monkeypatch.setattr(follow, "RunClient", lambda *_, **__: client)
    monkeypatch.setattr(follow, "FaultEndpoints", Truth)
    monkeypatch.setattr(follow, "time", MagicMock(monotonic=lambda: now_s[0]))
    lockstep = run.model_copy(update={"mode": "lockstep"})
    outcome = follow.follow(
        lockstep, group, Path("run.yaml"), Path("bag"), MagicMock(), follow.Interrupt()
    ).outcome
    assert outcome.verdict is Verdict.INVALID_HARNESS
    assert now_s[0] - died_s == pytest.approx(ends_s, abs=1.0)


@pytest.mark.parametrize("after_s", [4.0, 120.0, 1e6])
def test_a_camera_that_compiles_its_kernels_is_waited_for_before_the_run_begins(
    run: RunSpec, monkeypatch: pytest.MonkeyPatch, after_s: float
) -> None:
    """Each step of a goal is tried for 45 s, and this takes longer on a busy machine."""
    now_s, said = [100.0], list[str]()
    group = MagicMock(
        processes={names.SCENARIO_MANAGER: MagicMock(), names.FRONT_CAMERA: MagicMock()}
    )
    group.ended.return_value = []
    client = quiet_client(was_armed=False)
    client.outcome = RunOutcome(Verdict.VALID, ())
    client.camera_is_there.side_effect = lambda: now_s[0] >= 100.0 + after_s

    def spin(timeout_s: float) -> None:
        now_s[0] += timeout_s

    def begin(*_: object) -> None:
        assert now_s[0] >= 100.0 + after_s, "the run began before the camera could draw"

    client.spin.side_effect, client.begin.side_effect = spin, begin
    monkeypatch.setattr(follow, "RunClient", lambda *_, **__: client)
    monkeypatch.setattr(follow, "time", MagicMock(monotonic=lambda: now_s[0]))
    outcome = follow.follow(
        run, group, Path("run.yaml"), Path("bag"), said.append, follow.Interrupt()
    ).outcome
    waits = "compiles the camera's kernels (once, about 20 s)"
    assert (waits in " ".join(said)) == (after_s > 5.0)
    assert client.begin.called == (after_s < 1e6)
    if after_s < 1e6:
        assert outcome.verdict is Verdict.VALID
        return
    assert outcome.verdict is Verdict.INVALID_HARNESS
    (reason,) = outcome.reasons
    assert reason.startswith("front_camera could not draw within 300 s; ")
    assert waits in reason


@pytest.mark.parametrize("live", [MagicMock(start_at_once=True, remappings=()), None])
def test_ctrl_z_aborts_a_live_session_that_is_led(
    run: RunSpec, monkeypatch: pytest.MonkeyPatch, live: MagicMock | None
) -> None:
    """A process that stands still hears no abort, while the manager leads on."""
    group, interrupt = MagicMock(), follow.Interrupt()
    group.ended.return_value = []
    client, goes_on = quiet_client(was_armed=True), list[bool]()
    client.outcome = None

    def spin(timeout_s: float) -> None:
        led = bool(client.begin.called)
        if not goes_on or (led and len(goes_on) < 3):
            goes_on.append(interrupt.on_suspension())
        if led and len(goes_on) == 3:
            client.outcome = RunOutcome(Verdict.ABORTED if live else Verdict.VALID, ())
        assert client.spin.call_count < SPINS

    client.spin.side_effect = spin
    monkeypatch.setattr(follow, "RunClient", lambda *_, **__: client)
    words = MagicMock(**{"poll.return_value": None, "aborts_unasked.return_value": False})
    monkeypatch.setattr(follow, "TypedWords", lambda: words)
    monkeypatch.setattr(follow, "SETTLE_S", 0.0)
    outcome = follow.follow(
        run, group, Path("run.yaml"), Path("bag"), MagicMock(), interrupt, live
    ).outcome
    assert goes_on == [False, live is not None, live is not None]
    assert client.cancel.called is (live is not None)
    assert outcome.reasons == (("interrupted by SIGTSTP",) if live else ())
    assert not interrupt.on_suspension()


def test_lines_that_do_not_count_while_a_session_drives_are_answered_once_each(
    run: RunSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Objects drive on after "stop", and the terminal said nothing."""
    read, write = os.pipe()
    group = MagicMock()
    group.ended.return_value = []
    client = quiet_client(was_armed=True)
    client.outcome, said = None, list[str]()
    lines = ["stop", "abort!", "start", "", "abort"]

    def spin(timeout_s: float) -> None:
        if client.begin.called and lines and client.spin.call_count % 10 == 0:
            os.write(write, f"{lines.pop(0)}\n".encode())
        if client.cancel.called:
            client.outcome = RunOutcome(Verdict.ABORTED, ())
        assert client.spin.call_count < SPINS, said

    client.spin.side_effect = spin
    monkeypatch.setattr(follow, "RunClient", lambda *_, **__: client)
    monkeypatch.setattr(follow, "TypedWords", lambda: TypedWords(read))
    monkeypatch.setattr(follow, "SETTLE_S", 0.0)
    live = MagicMock(start_at_once=True, remappings=())
    try:
        outcome = follow.follow(
            run, group, Path("run.yaml"), Path("bag"), said.append, follow.Interrupt(), live
        ).outcome
    finally:
        os.close(read)
        os.close(write)
    assert said == ['only "abort" counts now'] * 4 + ["abort typed: aborting the session"]
    assert outcome.reasons == ("abort typed",)


def test_a_run_that_is_held_armed_for_its_faults_asks_again_when_the_word_runs_out(
    run: RunSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It goes step by step; what isn't started by then is disarmed first."""
    read, write = os.pipe()
    group, said = MagicMock(), list[str]()
    group.ended.return_value = []
    client, now_ns = quiet_client(was_armed=True), [0]
    client.loaded, client.outcome = (), None
    by_hand = MagicMock(not_in_time=None, is_armed=True, stays_armed=True, problems=())
    by_hand.lacks.return_value = []
    typed_s: list[float] = []

    def give_up() -> None:
        by_hand.is_armed = by_hand.stays_armed = False

    def spin(timeout_s: float) -> None:
        now_ns[0] += round(timeout_s * 1e9)
        if len(typed_s) < said.count(follow.PROMPT):
            typed_s.append(now_ns[0] / 1e9)
            os.write(write, b"start\n")
        elif by_hand.begin.call_count == 1:
            by_hand.not_in_time = ("ot1 moves",)
        elif by_hand.begin.call_count == 2:
            assert by_hand.give_up.called
            client.outcome = RunOutcome(Verdict.VALID, ())
        assert client.spin.call_count < SPINS

    client.spin.side_effect, by_hand.give_up.side_effect = spin, give_up
    by_hand.begin.side_effect = lambda _: setattr(by_hand, "not_in_time", None)
    clock = MagicMock(
        monotonic=lambda: now_ns[0] / 1e9, monotonic_ns=lambda: now_ns[0], time_ns=lambda: now_ns[0]
    )
    replace_session(monkeypatch, client, read, clock)
    monkeypatch.setattr(follow, "StepwiseClient", lambda *_: by_hand)
    monkeypatch.setattr(follow, "FaultEndpoints", MagicMock())
    monkeypatch.setattr(follow.faults, "FaultInjector", MagicMock())
    monkeypatch.setattr(follow._Following, "_followed", lambda _, outcome: MagicMock(is_=outcome))
    live = MagicMock(start_at_once=False, remappings=())
    faulty = run.model_copy(update={"faults": [Fault(kind="operator_abort")]})
    given = (Path("run.yaml"), Path("bag"), said.append, follow.Interrupt(), live)
    try:
        followed = follow.follow(faulty, group, *given)
    finally:
        os.close(read)
        os.close(write)
    assert followed.is_ == RunOutcome(Verdict.VALID, ())  # type: ignore[attr-defined]
    assert "not started within 10 s: ot1 moves" in said
    until_s = [one.args[0] / 1e9 for one in by_hand.begin.call_args_list]
    assert until_s == pytest.approx([at_s + 10.0 for at_s in typed_s], abs=0.2)
    assert not client.begin.called


def test_step_by_step_nothing_is_asked_for_after_the_word_has_run_out(
    run: RunSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each step is tried for 45 s if no other time is given."""
    now_s = [100.0]
    clock = MagicMock(
        monotonic=lambda: now_s[0],
        monotonic_ns=lambda: round(now_s[0] * 1e9),
        time_ns=lambda: round((now_s[0] + 1e6) * 1e9),
    )
    monkeypatch.setattr(runner_client, "time", clock)
    node = MagicMock()
    services: dict[str, MagicMock] = {}
    node.create_client.side_effect = lambda _, name: services.setdefault(name, MagicMock())
    client = StepwiseClient(node, run, "run.yaml")

    def call_count_of(name: str) -> int:
        return int(services[name].call_async.call_count)

    def drive(state: SessionPhase, seconds: float, *, may_start: bool = True) -> None:
        client._on_session(MagicMock(state=int(state)))
        for _ in range(round(seconds)):
            now_s[0] += 1.0
            client.drive(may_start)
            if client._waiting is not None:
                refusal = MagicMock(
                    accepted=False, error_code=1, error_msg="", missing=["ot1 moves"]
                )
                client._on_answer(client._waiting, MagicMock(**{"result.return_value": refusal}))

    client.begin(not_after_ns=round((now_s[0] + 10.0 + 1e6) * 1e9))
    drive(SessionPhase.CONNECTED, 3.0)
    drive(SessionPhase.ARMED, 7.0)
    assert (call_count_of("arm"), call_count_of("start")) == (3, 7)
    assert not call_count_of(names.LOAD_SCENARIO)
    assert client.problems == ()
    assert client.not_in_time is None
    drive(SessionPhase.ARMED, 20.0)
    assert call_count_of("start") == 7
    assert client.not_in_time == ("ot1 moves",)
    assert client.stays_armed
    for _ in range(5):
        client.give_up()
        now_s[0] += 0.5
    assert call_count_of("disarm") == 2
    # The next word goes on from where it stands.
    client.begin(not_after_ns=round((now_s[0] + 10.0 + 1e6) * 1e9))
    assert client.not_in_time is None
    drive(SessionPhase.CONNECTED, 5.0)
    assert (call_count_of("arm"), call_count_of("start")) == (8, 7)
    client.begin()
    drive(SessionPhase.LOADED, 2.0)
    assert call_count_of(names.LOAD_SCENARIO) == 1
