"""The pre-flight check of a policy behind an EgodriverService: is it fit to drive here?

It asks through the same client as a run, about a straight road that the package's test loop draws.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache
from statistics import quantiles

import cv2
from carla_driver_interface.geometry import Pose
from carla_driver_interface.testing import FakeCamera, render_road

from ssp_core.clock import ns_to_seconds
from ssp_core.geometry import Pose2
from ssp_core.motion.trajectory import Trajectory, check_trajectory
from ssp_core.run_file.model import Camera
from ssp_core.world.driver import ROUTE_STEP_M, EgoSample, GivenAnswer, Question, SeenFrame
from ssp_vla_bridge.egodriver.client import ENDED, EgodriverDriver
from ssp_vla_bridge.egodriver.options import EgodriverOptions

CALLS = 20
SIDE_BY_SIDE = 8
_FEW = 3
_STEP_S = 0.1
_SPEED_MPS = 8.0
# A camera that is turned: with either convention taken for the other it would look elsewhere.
_CAMERA = Camera(width_px=640, height_px=360, hfov_deg=60.0, pitch_down_rad=0.1, yaw_left_rad=0.3)
# Places of the same scene in local frames that are turned against each other.
_TURNED_RAD = (0.0, 2.0)
_SAME_M = 0.2
_LEAST_END_S = 2.0
_BOUND_S = 2.0
_SAYS = "mend what its server says of the call: it ends the run as died"
_REVISIONS = {1: "the camera's body", 2: "the optical frame"}


@dataclass(frozen=True)
class Finding:
    """One part of the check.

    Args:
        name: of the part.
        passed: True where it is as it must be.
        seen: by the check.
        mend: what to change; empty where it passed.
    """

    name: str
    passed: bool
    seen: str
    mend: str = ""


def check_policy(options: EgodriverOptions) -> list[Finding]:
    """Check a policy; where it can't be asked at all, the first finding is the only one.

    Args:
        options: of the connection.
    """
    one = EgodriverDriver("check", options)
    problem, version, revision = one.problem, one.version, one.revision
    one.close()
    if problem:
        mend = (
            "start the server, name its address, and with --tls its certificates if it has any; it "
            "speaks revision 1 or 2"
        )
        return [Finding("version", False, problem, mend)]
    observation = (
        f"{version or 'no name'}, revision {revision}: rig_to_camera is {_REVISIONS[revision]}"
    )
    answers = _answers_of(options, [_question(k, seed=1) for k in range(CALLS)])
    return [
        Finding("version", True, observation),
        _frames(options),
        _answers(answers),
        _latency(answers),
        _terminate(answers),
        _sessions(options),
        _no_route(options),
    ]


def _question(k: int, seed: int, yaw_rad: float = 0.0, speed_mps: float = _SPEED_MPS) -> Question:
    """Return the question of a step on a straight road, whose direction in the map is free."""
    stamp_ns = round((10.0 + _STEP_S * k) * 1e9)
    way_m = speed_mps * _STEP_S * k
    backs = [_STEP_S * n for n in range(17, -1, -1)]
    return Question(
        number=k + 1,
        stamp_ns=stamp_ns,
        history=tuple(
            EgoSample(-back, -back * speed_mps, 0.0, 0.0, speed_mps, 0.0) for back in backs
        ),
        route_m=tuple((ROUTE_STEP_M * n, 0.0) for n in range(81)),
        frames=(SeenFrame(stamp_ns, _picture(way_m)),),
        camera=_CAMERA,
        pose=Pose2(way_m * math.cos(yaw_rad), way_m * math.sin(yaw_rad), yaw_rad),
        seed=seed,
    )


@lru_cache(maxsize=128)
def _picture(way_m: float) -> bytes:
    camera = FakeCamera(
        width=_CAMERA.width_px,
        height=_CAMERA.height_px,
        fov_deg=_CAMERA.hfov_deg,
        x=_CAMERA.forward_m,
        y=_CAMERA.left_m,
        z=_CAMERA.height_m,
        pitch_down_deg=math.degrees(_CAMERA.pitch_down_rad),
        yaw_left_deg=math.degrees(_CAMERA.yaw_left_rad),
    )
    red_first = render_road(camera, Pose.from_xyz_yaw(way_m, 0.0, 0.0, 0.0))
    return bytes(cv2.imencode(".jpg", cv2.cvtColor(red_first, cv2.COLOR_RGB2BGR))[1])


def _answers_of(options: EgodriverOptions, questions: Sequence[Question]) -> list[GivenAnswer]:
    """Return the answers of one session, up to the one with which it ends."""
    driver = EgodriverDriver("check", options)
    answers: list[GivenAnswer] = []
    try:
        for question in questions:
            answers.append(driver.give(question))
            if answers[-1].answer is None:
                break
    finally:
        driver.close()
    return answers


def _plan(reply: GivenAnswer) -> Trajectory | None:
    return None if reply.answer is None else reply.answer.trajectory


def _ended(answers: Sequence[GivenAnswer]) -> str:
    return answers[-1].ended


def _mend(ended: str, otherwise: str) -> str:
    """Return how to mend a session that ended for a reason; one that took too long, in time."""
    if "deadline_s" not in ended:
        return otherwise
    return (
        "load the model before a session begins, make it faster, or give it more time: --deadline "
        "here, deadline_s of the driver in a run"
    )


def _apart_m(a: Trajectory | None, b: Trajectory | None) -> float:
    """Return how far two plans of the same times are apart at most; infinite for other ones."""
    if a is None or b is None:
        return 0.0 if a is b else math.inf
    if a.t_s != b.t_s:
        return math.inf
    places = zip(zip(a.x_m, a.y_m, strict=True), zip(b.x_m, b.y_m, strict=True), strict=True)
    apart = [math.dist(p, q) for p, q in places]
    return max(apart) if all(map(math.isfinite, apart)) else math.inf


def _frames(options: EgodriverOptions) -> Finding:
    """Ask about the same scene in two local frames, with a camera that is pitched and yawed."""
    sets = [
        _answers_of(options, [_question(k, seed=2, yaw_rad=yaw_rad) for k in range(_FEW)])
        for yaw_rad in _TURNED_RAD
    ]
    if ended := _ended(sets[0]) or _ended(sets[1]):
        mend = "accept one forward pinhole camera, or name the one it wants with --camera"
        if ended.startswith("drive failed"):
            mend = _SAYS
        return Finding("frames", False, ended, _mend(ended, mend))
    apart_m = max(_apart_m(_plan(a), _plan(b)) for a, b in zip(*sets, strict=True))
    passed = apart_m <= _SAME_M
    observation = (
        "takes a camera that is pitched and yawed; the same scene in a local frame that is turned "
        f"by {_TURNED_RAD[1]:g} rad gets plans that are {apart_m:.2g} m apart"
    )
    mend = "answer in the local frame: the pose at time_now_us times the plan in the rig frame"
    return Finding("frames", passed, observation, "" if passed else mend)


def _answers(answers: Sequence[GivenAnswer]) -> Finding:
    plans = [_plan(one) for one in answers]
    wrong = {
        word: sum(word in check_trajectory(plan) for plan in plans if plan is not None)
        for word in ("shape", "non_finite", "timestamps", "coverage")
    }
    faults = [f"{count} {word}" for word, count in wrong.items() if count]
    ends = [plan.t_s[-1] for plan in plans if plan is not None and plan.t_s]
    empty = sum(plan is None for plan in plans)
    shortest_s = min(ends, default=0.0)
    observation = f"{empty} of {len(answers)} answers without a plan"
    if ends:
        observation += f", plans end {shortest_s:.3g} s ahead"
    if faults:
        observation += f"; invalid: {', '.join(faults)}"
    late = any(plan is None for plan in plans[len(plans) // 2 :])
    passed = not late and not faults and shortest_s >= _LEAST_END_S and len(answers) == CALLS
    mend = (
        "answer each call once frame, motion and route are there, by finite poses at rising "
        f"absolute µs up to {_LEAST_END_S:g} s ahead at least"
    )
    return Finding("answers", passed, observation, "" if passed else _mend(_ended(answers), mend))


def _latency(answers: Sequence[GivenAnswer]) -> Finding:
    if ended := _ended(answers):
        observation = f"only {len(answers) - 1} of {CALLS} calls were answered"
        mend = f"let a session go on for {CALLS} calls, see terminate"
        return Finding("latency", False, observation, _mend(ended, mend))
    took_s = sorted(ns_to_seconds(one.latency.total_ns) for one in answers)
    cuts = quantiles(took_s, n=100, method="inclusive")
    p50_s, p99_s = cuts[49], cuts[98]
    passed = p99_s <= _BOUND_S
    mend = f"give --latency measured:S with an S above {p99_s:.2g}, or make it faster"
    observation = (
        f"p50 {p50_s:.3g} s, p99 {p99_s:.3g} s of {len(took_s)} calls, with frame and motion"
    )
    return Finding("latency", passed, observation, "" if passed else mend)


def _terminate(answers: Sequence[GivenAnswer]) -> Finding:
    ended = _ended(answers)
    observation = ended or f"goes on for {len(answers)} calls, on a free road"
    if not ended:
        return Finding("terminate", True, observation)
    mend = _SAYS
    if ended == ENDED:
        mend = "leave terminate_session unset: it ends the run as died"
    return Finding("terminate", False, observation, _mend(ended, mend))


def _sessions(options: EgodriverOptions) -> Finding:
    """Ask in eight sessions one by one, then at once; each must get the same answers again."""
    questions = [
        [_question(n, 10 + k, yaw_rad=0.5 * k, speed_mps=4.0 + k) for n in range(_FEW)]
        for k in range(SIDE_BY_SIDE)
    ]
    alone = [_answers_of(options, one) for one in questions]
    together = _side_by_side(options, questions)
    if ended := next(filter(None, map(_ended, [*alone, *together])), ""):
        mend = f"take {SIDE_BY_SIDE} sessions at once, each with a state of its own"
        return Finding("sessions", False, ended, _mend(ended, mend))
    apart_m = max(
        _apart_m(_plan(a), _plan(b))
        for one, other in zip(alone, together, strict=True)
        for a, b in zip(one, other, strict=True)
    )
    passed = apart_m <= _SAME_M
    observation = f"{SIDE_BY_SIDE} at once get plans that are {apart_m:.2g} m from those alone"
    mend = "keep a state of its own for each session_uuid, and draw by its random_seed"
    return Finding("sessions", passed, observation, "" if passed else mend)


def _side_by_side(
    options: EgodriverOptions, questions: Sequence[Sequence[Question]]
) -> list[list[GivenAnswer]]:
    """Return the answers of sessions that are all open from the first question to the last.

    The last one is that with which any of them ends.
    """
    drivers = [EgodriverDriver("check", options) for _ in questions]
    steps: list[list[GivenAnswer]] = []
    try:
        with ThreadPoolExecutor(len(drivers)) as pool:
            for step in zip(*questions, strict=True):
                steps.append(list(pool.map(lambda driver, one: driver.give(one), drivers, step)))
                if any(one.answer is None for one in steps[-1]):
                    break
    finally:
        for driver in drivers:
            driver.close()
    return [list(answers) for answers in zip(*steps, strict=True)]


def _no_route(options: EgodriverOptions) -> Finding:
    """Ask with a route of which no point is there."""
    questions = [replace(_question(k, seed=3), route_m=()) for k in range(_FEW)]
    answers = _answers_of(options, questions)
    plans = [_plan(one) for one in answers]
    invalid = any(plan is not None and check_trajectory(plan) for plan in plans)
    ended = _ended(answers)
    mend = "drop the points of a route that are NaN, and answer without one"
    if ended or invalid:
        observation = ended or "a route of NaN alone makes plans invalid"
        return Finding("route", False, observation, _mend(ended, mend))
    empty = sum(plan is None for plan in plans)
    return Finding("route", True, f"a route of NaN alone: {empty} of {len(plans)} answers empty")
