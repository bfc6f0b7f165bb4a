"""A VUT whose stated states are false: such a session isn't armed, or it ends, and says why."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest

from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Fault, RunSpec
from ssp_core.safety.start_heading import UNKNOWN_AT_REST
from ssp_core.vocabulary import SessionPhase, Verdict
from ssp_core.world.plant import ManagerUpdate, Plant, StepReport, make_plant
from ssp_scenario_manager.compile.targets.folder import prepare_run
from ssp_scenario_manager.run.in_process_session import InProcessSession
from ssp_scenario_manager.session.outbox import StateChanged, TriggerDecision
from ssp_scenario_manager.session.state_machine import STANDSTILL_GIVEN_UP

Change = Callable[[ObjectState], ObjectState]


@pytest.fixture(scope="module")
def spec(tmp_path_factory: pytest.TempPathFactory) -> RunSpec:
    """A cut-in on a site whose road leads 37° off the map's x axis, without camera and traffic."""
    folder = tmp_path_factory.mktemp("run")
    run = prepare_run("cut_in", "north_track", folder, seed=5, mode="lockstep")
    return run.model_copy(update={"camera": None, "traffic": []})


class Falsified:
    """A plant of which the VUT's states are stated falsely.

    Attributes:
        truth_mps: speed of the VUT at each time of a report.
    """

    def __init__(self, plant: Plant, change: Change) -> None:
        self._plant = plant
        self._change = change
        self.command = plant.command
        self.close = plant.close
        self.truth_mps: dict[int, float] = {}

    def hold(self, word: ManagerUpdate) -> StepReport:
        return self._stated(self._plant.hold(word))

    def advance(self, word: ManagerUpdate) -> StepReport:
        return self._stated(self._plant.advance(word))

    def _stated(self, report: StepReport) -> StepReport:
        for state in report.truths:
            if state.object_id == "vut":
                self.truth_mps[report.now_ns] = state.speed_mps
        return replace(report, vut_states=tuple(map(self._change, report.vut_states)))


def play(spec: RunSpec, change: Change) -> tuple[InProcessSession, Falsified]:
    plant = Falsified(make_plant(spec, None), change)
    session = InProcessSession(spec, plant)
    try:
        session.run()
    finally:
        plant.close()
    return session, plant


def turned(state: ObjectState) -> ObjectState:
    return replace(state, yaw_rad=math.remainder(state.yaw_rad + math.pi, math.tau))


def test_a_sound_vut_contradicts_nothing(spec: RunSpec) -> None:
    session, _ = play(spec, lambda state: state)
    assert (session.session.verdict, session.session.reasons) == (Verdict.VALID, ())


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        (
            lambda s: replace(s, speed_mps=s.speed_mps * math.cos(s.yaw_rad)),
            "the twist looks like map axes",
        ),
        (lambda s: turned(s) if s.speed_mps > 0.5 else s, "yaw turned by 180°"),
        (lambda s: replace(s, speed_mps=3.6 * s.speed_mps), "speed not in m/s, maybe in km/h"),
        (lambda s: replace(s, speed_mps=0.0), "empty twist"),
    ],
)
def test_a_vut_that_contradicts_its_places_ends_the_session(
    spec: RunSpec, change: Change, kind: str
) -> None:
    session, plant = play(spec, change)
    (reason,) = session.session.reasons
    assert reason.startswith("state_contradicts: vut: 0.5")
    assert f"({kind}: " in reason
    assert session.session.verdict is Verdict.FAILED_SAFETY
    assert session.session.state is SessionPhase.ABORTED
    assert session.of_kind(TriggerDecision) == []
    assert_it_stands(session, plant)


def assert_it_stands(session: InProcessSession, plant: Falsified) -> None:
    """Everything is said to stand, and the VUT did at that time."""
    told = session.of_kind(StateChanged)[-1]
    assert told.reason == "everything stands"
    assert plant.truth_mps[told.stamp_ns] < 0.1


def test_a_vut_that_faces_backwards_is_not_armed(spec: RunSpec) -> None:
    session, _ = play(spec, turned)
    assert session.problems == (
        "vut is turned by +3.14 rad from its start's heading, limit 0.35 rad",
    )
    assert session.session.verdict is Verdict.NONE


def by_course(spec: RunSpec) -> RunSpec:
    """The run of a VUT whose receiver has one antenna."""
    limits = spec.limits.model_copy(update={"heading_by_course": ["vut"]})
    return spec.model_copy(update={"limits": limits})


def single_antenna(yaw_rad: float) -> Change:
    """A source that states any yaw while it stands, and the course over ground beyond."""
    return lambda s: s if abs(s.speed_mps) > 0.1 else replace(s, yaw_rad=yaw_rad)


def the_other_way(spec: RunSpec) -> Change:
    """Return a change that states a start backwards, as the single antenna of a VUT would."""
    start = spec.vut.start

    def change(state: ObjectState) -> ObjectState:
        x_m, y_m = 2.0 * start.x_m - state.x_m, 2.0 * start.y_m - state.y_m
        mirrored = replace(state, x_m=x_m, y_m=y_m)
        return turned(mirrored) if state.speed_mps > 0.1 else mirrored

    return change


def test_a_vut_with_one_antenna_may_state_any_yaw_at_rest(spec: RunSpec) -> None:
    start_rad = spec.vut.start.yaw_rad
    session, _ = play(by_course(spec), single_antenna(start_rad + 2.5))
    assert (session.session.verdict, session.session.reasons) == (Verdict.VALID, ())
    armed = next(one for one in session.of_kind(StateChanged) if one.event == "arm")
    assert armed.reason.endswith(f"; vut: {UNKNOWN_AT_REST}")
    session, _ = play(spec, single_antenna(start_rad + 2.5))
    assert session.problems == (
        "vut is turned by +2.50 rad from its start's heading, limit 0.35 rad",
    )


def test_a_vut_with_one_antenna_that_leaves_backwards_ends_the_session(spec: RunSpec) -> None:
    session, plant = play(by_course(spec), the_other_way(spec))
    (reason,) = session.session.reasons
    assert reason.startswith("state_contradicts: vut: its first 1.")
    assert "lead +180° off its start's heading, limit 20° at 1." in reason
    assert session.session.verdict is Verdict.FAILED_SAFETY
    assert session.session.state is SessionPhase.ABORTED
    assert session.of_kind(TriggerDecision) == []
    assert_it_stands(session, plant)


def test_an_abort_waits_for_the_places_where_the_twist_is_empty(spec: RunSpec) -> None:
    """The session aborts before the contradiction has held; the VUT states that it stands."""
    abort = spec.model_copy(update={"faults": [Fault(kind="operator_abort", at_s=1.2)]})
    session, plant = play(abort, lambda s: replace(s, speed_mps=0.0))
    assert session.session.reasons == ("abort by operator: injected fault at 1.20 s",)
    assert max(plant.truth_mps.values()) > 2.0
    assert_it_stands(session, plant)


def test_a_vut_without_places_is_not_known_to_stand(spec: RunSpec) -> None:
    def lost(state: ObjectState) -> ObjectState:
        if state.stamp_ns < 3_000_000_000:
            return state
        return replace(state, x_m=math.nan, y_m=math.nan, speed_mps=0.0)

    session, _ = play(spec, lost)
    told = session.of_kind(StateChanged)[-1]
    assert (told.event, told.reason) == (STANDSTILL_GIVEN_UP, "not known to stand: vut")
    assert session.session.state is SessionPhase.ABORTING
    assert session.session.verdict is Verdict.FAILED_SAFETY
