"""The driver's place in a session: when it is asked, and when its answer counts (METHOD 8.3)."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import Any

import pytest

from ssp_core.errors import InputError
from ssp_core.geometry import Polyline
from ssp_core.motion.trajectory import Trajectory
from ssp_core.run_file.driven import Driven
from ssp_core.run_file.latency import Latency
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import ObjectClass
from ssp_core.world.driver import Answer, DriveMode, DriveReport, EgoSample, Question, history_of
from ssp_ot_controller.bodies.dynamics import LIMITS, BodyState, step_vehicle
from ssp_ot_controller.driving.baselines import BASELINES, lane_plan, make_driver
from ssp_ot_controller.driving.pilot import Cruise, Pilot
from ssp_ot_controller.sil.vut_driver import steer
from tests.support.runs import cut_in_run
from tests.support.states import object_state

STEP_NS = 20_000_000


class Scripted:
    """A driver that says what a function says."""

    privileged = False

    def __init__(self, says: Callable[[Question], Answer] = lane_plan) -> None:
        self.says = says
        self.questions: list[Question] = []

    def answer(self, question: Question) -> Answer:
        self.questions.append(question)
        return self.says(question)


def driven(latency_s: float = 0.0) -> Driven:
    return Driven(
        driver="scripted",
        latency=Latency(latency_s),
        first_request_s=0.2,
        hand_over_s=1.0,
        end_s=9.0,
        observable_s=3.0,
    )


def drive(
    driver: Scripted, latency_s: float = 0.0, seconds: float = 2.0
) -> list[tuple[float, DriveReport]]:
    """Reports of the pilot of a VUT that keeps 10 m/s whatever it is commanded."""
    pilot = Pilot(RunSpec.model_validate(cut_in_run()), driven(latency_s), driver)
    found = []
    for step in range(round(seconds * 50) + 1):
        now_ns = step * STEP_NS
        vut = object_state("vut", x_m=0.2 * step, speed_mps=10.0, stamp_ns=now_ns)
        found.append((now_ns / 1e9, pilot.step(step, now_ns, vut, (vut,))[1]))
    return found


def times(reports: list[tuple[float, DriveReport]], field: str) -> list[float]:
    return [at_s for at_s, report in reports if getattr(report, field) is not None]


def test_without_latency_each_frame_is_asked_about_and_effective_at_once() -> None:
    reports = drive(Scripted())
    asked = times(reports, "question")
    assert asked == pytest.approx([0.2 + 0.1 * k for k in range(19)])
    assert times(reports, "effective_answer") == asked


def test_one_question_is_open_and_the_next_is_of_the_first_frame_at_which_none_is() -> None:
    reports = drive(Scripted(), latency_s=0.25)
    assert times(reports, "question")[:4] == pytest.approx([0.2, 0.5, 0.8, 1.1])
    # Effective at the first step at or after t + L.
    assert times(reports, "effective_answer")[:4] == pytest.approx([0.46, 0.76, 1.06, 1.36])


def test_a_latency_of_a_frame_is_open_up_to_the_next_frame() -> None:
    reports = drive(Scripted(), latency_s=0.1)
    assert times(reports, "question")[:3] == pytest.approx([0.2, 0.3, 0.4])
    assert times(reports, "effective_answer")[:3] == pytest.approx([0.3, 0.4, 0.5])


def test_a_plan_lies_where_the_vut_was_at_its_frame_and_not_where_it_is() -> None:
    reports = drive(Scripted(), latency_s=0.5)
    first = next(report.effective for _, report in reports if report.effective is not None)
    assert (first.execute_at_ns, first.points[0].x_m) == (200_000_000, pytest.approx(2.0))


def test_it_leads_from_the_hand_over_on() -> None:
    modes = {at_s: report.mode for at_s, report in drive(Scripted())}
    assert (modes[0.98], modes[1.0]) == (DriveMode.COMMAND, DriveMode.PLAN)


def test_a_driver_that_says_nothing_falls_back_from_the_hand_over_on() -> None:
    reports = drive(Scripted(lambda _: Answer(None)))
    assert {report.mode for at_s, report in reports if at_s >= 1.0} == {DriveMode.FALLBACK}
    refused = {report.effective_answer.refused for _, report in reports if report.effective_answer}
    assert refused == {"not_ready"}


def test_an_empty_answer_keeps_the_plan_before_which_is_stale_until_the_next_one() -> None:
    def says(question: Question) -> Answer:
        quiet = 1_200_000_000 <= question.stamp_ns < 1_500_000_000
        return Answer(None) if quiet else lane_plan(question)

    reports = drive(Scripted(says))
    stale = [at_s for at_s, report in reports if report.mode is DriveMode.STALE]
    assert (stale[0], stale[-1]) == pytest.approx((1.2, 1.48))


def test_a_plan_that_is_driven_to_its_end_is_fallback_behind_it() -> None:
    def says(question: Question) -> Answer:
        late = question.stamp_ns > 250_000_000
        t = (0.0, 1.0, 2.0)
        return Answer(None if late else Trajectory(t, (0.0, 10.0, 20.0), (0.0, 0.0, 0.0)))

    modes = {at_s: report.mode for at_s, report in drive(Scripted(says), seconds=3.0)}
    assert (modes[2.18], modes[2.2]) == (DriveMode.STALE, DriveMode.FALLBACK)


def test_a_driver_that_raises_has_died_and_is_asked_no_more() -> None:
    def says(question: Question) -> Answer:
        raise MemoryError("1 GB")

    driver = Scripted(says)
    reports = drive(driver)
    assert len(driver.questions) == 1
    assert reports[-1][1].died == "MemoryError: 1 GB"


@pytest.mark.parametrize(
    "answer",
    [
        None,
        "I keep my speed.",
        Answer(Trajectory(("0", "1"), ("a", "b"), (0.0, 0.0))),  # type: ignore[arg-type]
        Answer(Trajectory((0.0, 1.0, 2.0), (0.0, 10.0), (0.0,))),
    ],
)
def test_a_driver_whose_answer_can_not_be_read_has_died_or_is_refused(answer: Any) -> None:
    """It ends the run, never the campaign."""
    reports = drive(Scripted(lambda _: answer))
    refused = {report.effective_answer.refused for _, report in reports if report.effective_answer}
    assert reports[-1][1].died.startswith("its answer can't be read") or all(refused), refused


def test_an_error_counts_from_t_plus_its_latency_on() -> None:
    """The plan before is driven up to then: an error comes no sooner than an answer."""

    def says(question: Question) -> Answer:
        if question.stamp_ns >= 1_100_000_000:
            raise RuntimeError("out of memory")
        return lane_plan(question)

    reports = drive(Scripted(says), latency_s=0.25)
    # The frames at 0.2, 0.5 and 0.8 s are answered, the one at 1.1 s isn't.
    dead = [at_s for at_s, report in reports if report.died]
    assert dead[0] == pytest.approx(1.36)
    assert {report.dies for at_s, report in reports if 1.1 <= at_s < 1.35} == {
        "RuntimeError: out of memory"
    }
    assert all(r.mode is DriveMode.PLAN for at_s, r in reports if 1.1 <= at_s < 1.35)


def test_a_driver_that_leaves_the_process_has_died() -> None:
    def says(question: Question) -> Answer:
        sys.exit(3)

    assert drive(Scripted(says))[-1][1].died == "SystemExit: 3"


def test_a_question_holds_motion_and_lane_and_no_truth() -> None:
    driver = Scripted()
    drive(driver)
    question = driver.questions[-1]
    assert question.privileged is None
    assert question.history[-1].t_s == 0.0
    assert question.history[0].t_s == pytest.approx(-1.7)
    assert question.history[0].x_m == pytest.approx(-17.0)
    assert question.route_m[0] == pytest.approx((0.0, 0.0))
    assert question.route_m[-1] == pytest.approx((80.0, 0.0))
    known = {"number", "stamp_ns", "history", "route_m", "privileged", "frames", "camera"}
    # For interfaces with a map frame and with sampling; no model is shown the pose as it is.
    assert set(type(question).__slots__) == known | {"pose", "seed"}


def test_a_route_is_the_lane_wherever_the_vut_avoids_to() -> None:
    """It never follows an avoidance, of the VUT or of anybody else."""
    driver = Scripted()
    pilot = Pilot(RunSpec.model_validate(cut_in_run()), driven(), driver)
    for step in range(60):
        now_ns = step * STEP_NS
        place = {"x_m": 0.2 * step, "y_m": 1.5, "yaw_rad": 0.3}
        vut = object_state("vut", **place, speed_mps=10.0, stamp_ns=now_ns)
        pilot.step(step, now_ns, vut, (vut,))
    question = driver.questions[-1]
    assert question.pose.y_m == 1.5
    lane = [question.pose.to_parent(x, y) for x, y in question.route_m]
    assert [y for _, y in lane] == pytest.approx([0.0] * 81, abs=1e-9)


def test_a_history_turns_by_the_smaller_angle_where_the_heading_wraps() -> None:
    before = object_state("vut", yaw_rad=math.pi - 0.01, stamp_ns=0)
    now = object_state("vut", yaw_rad=-math.pi + 0.01, stamp_ns=STEP_NS)
    first, _ = history_of([before, now])
    assert first.yaw_rad == pytest.approx(-0.02)


def test_an_unknown_driver_and_a_wrong_option_are_refused_with_what_there_is() -> None:
    with pytest.raises(InputError, match=r"is no driver.*constant_velocity"):
        make_driver("nobody", {})
    with pytest.raises(InputError, match="aeb"):
        make_driver("aeb", {"ttc": 1.0})
    with pytest.raises(InputError, match="takes no options"):
        make_driver("no_response", {"a": 1})


@pytest.mark.parametrize("name", BASELINES)
def test_every_baseline_answers_with_a_plan_that_is_driven(name: str) -> None:
    driver = make_driver(name, {})
    assert driver is not None
    pilot = Pilot(RunSpec.model_validate(cut_in_run()), driven(), driver)
    vut = object_state("vut", speed_mps=10.0, stamp_ns=0)
    other = object_state("ot1", x_m=40.0, speed_mps=5.0)
    for step in range(60):
        _, report = pilot.step(step, step * STEP_NS, vut, (vut, other))
        assert not report.died
        assert report.effective_answer is None or not report.effective_answer.refused


def test_aeb_brakes_at_its_time_to_collision_and_not_for_what_is_beside_its_lane() -> None:
    def brakes(gap_m: float, y_m: float = 0.0, speed_mps: float = 0.0) -> bool:
        driver = make_driver("aeb", {"ttc_s": 2.0})
        assert driver is not None
        pilot = Pilot(RunSpec.model_validate(cut_in_run()), driven(), driver)
        vut = object_state("vut", speed_mps=10.0)
        x_m = vut.size.front_m + gap_m + vut.size.rear_m
        other = object_state("ot1", x_m=x_m, y_m=y_m, speed_mps=speed_mps)
        for step in range(11):
            _, report = pilot.step(step, step * STEP_NS, vut, (vut, other))
        assert report.effective_answer is not None
        plan = report.effective_answer.answer.trajectory
        assert plan is not None
        return plan.x_m[-1] < 49.0

    assert brakes(19.9)
    assert not brakes(20.1)
    assert not brakes(15.0, y_m=3.5)
    assert not brakes(15.0, speed_mps=9.9)


def test_a_plan_along_a_bend_turns_from_its_beginning_on() -> None:
    """A lane is given by points 2 m apart, and of a plan little is driven before the next one."""
    radius_m, speed_mps = 12.0, 5.0
    bend = tuple(
        (radius_m * math.sin(s / radius_m), radius_m * (1.0 - math.cos(s / radius_m)))
        for s in range(0, 40, 2)
    )
    sample = EgoSample(0.0, 0.0, 0.0, 0.0, speed_mps, 0.0)
    plan = lane_plan(Question(1, 0, (sample,), bend)).trajectory
    assert plan is not None
    beside_m = [
        math.hypot(x_m, y_m - radius_m) - radius_m
        for x_m, y_m in zip(plan.x_m, plan.y_m, strict=True)
    ]
    assert max(map(abs, beside_m)) < 1e-3


def test_a_vut_without_plans_keeps_the_speed_that_a_driver_sees_first() -> None:
    pilot = Pilot(RunSpec.model_validate(cut_in_run()), driven(), None)
    commands = []
    for step, speed_mps in ((5, 9.0), (10, 10.0), (11, 10.001), (50, 10.002)):
        vut = object_state("vut", speed_mps=speed_mps, stamp_ns=step * STEP_NS)
        commands.append(pilot.step(step, step * STEP_NS, vut, (vut,))[0])
    assert commands[-1] is not None
    assert commands[-1].acceleration_mps2 == pytest.approx(-0.002)


def test_a_vut_without_plans_keeps_its_lane_in_a_bend() -> None:
    """Pure pursuit turned in before the bend, by 0.1 m, and a plan along the lane doesn't."""
    radius_m, speed_mps, dt_s = 12.0, 5.0, 0.02
    bend = [
        (20.0 + radius_m * math.sin(s / radius_m), radius_m * (1.0 - math.cos(s / radius_m)))
        for s in (0.5 * n for n in range(37))
    ]
    path = Polyline([(0.0, 0.0), *bend])
    cruise, body = Cruise(path), BodyState(0.0, 0.0, 0.0, speed_mps)
    beside_m = []
    for _ in range(350):
        place = {"x_m": body.x_m, "y_m": body.y_m, "yaw_rad": body.yaw_rad}
        command = cruise.command(object_state("vut", **place, speed_mps=body.speed_mps))
        body = step_vehicle(body, command, LIMITS[ObjectClass.CAR], dt_s)
        beside_m.append(path.project_beyond(body.x_m, body.y_m)[1])
    assert path.project_beyond(body.x_m, body.y_m)[0] > 34.0
    assert max(map(abs, beside_m)) < 0.05


def test_on_a_straight_a_vut_without_plans_is_steered_by_pure_pursuit_alone() -> None:
    path = Polyline([(0.0, 0.0), (70.0, 40.0)])
    vut = object_state("vut", x_m=10.0, y_m=6.0, yaw_rad=0.5, speed_mps=8.0)
    station_m, _ = path.project_beyond(vut.x_m, vut.y_m)
    assert Cruise(path).command(vut).curvature_1pm == steer(vut, path, station_m)
