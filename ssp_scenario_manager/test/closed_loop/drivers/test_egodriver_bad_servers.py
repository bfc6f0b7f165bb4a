"""Servers that misbehave: each is refused or becomes a refused plan, with its reason."""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Callable
from concurrent import futures
from pathlib import Path
from typing import Any

import grpc  # type: ignore[import-untyped] # has no types
import pytest
from carla_driver_interface import protocol as proto

from ssp_core.motion.trajectory import Trajectory
from ssp_core.run_file.latency import Latency
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import Verdict
from ssp_core.world.driver import driver_options
from ssp_ot_controller.driving.plan import MapPlan, plan_of
from ssp_scenario_manager.closed_loop.outcomes.outcome import outcome_of
from ssp_scenario_manager.closed_loop.starts.start import Start, make_start
from ssp_scenario_manager.compile.targets.folder import prepare_run
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.run.in_process import run_in_process
from ssp_vla_bridge.egodriver import client, exact, wire
from ssp_vla_bridge.egodriver.client import EgodriverDriver
from ssp_vla_bridge.egodriver.options import read_options
from tests.support.models.egodrivers import SMALL, Straight, question, serving
from tests.support.processes.waiting import DEADLINE_S
from tests.support.self_signed import CERTIFICATE, KEY

CALLS = (
    "get_version",
    "start_session",
    "submit_image_observation",
    "submit_egomotion_observation",
    "submit_route",
    "drive",
)
PATIENT_S = 600.0


class Bad(Straight):
    """A policy that does something else in one call.

    Args:
        call: in which.
        does: what; takes the servicer's own method, the request and the context.
    """

    def __init__(self, call: str, does: Callable[..., Any]) -> None:
        super().__init__()
        good = getattr(self, call)
        setattr(self, call, lambda request, context: does(good, request, context))


def drives(url: str, **given: Any) -> EgodriverDriver:
    options = {"url": url, "deadline_s": PATIENT_S, **given}
    return EgodriverDriver("bad", read_options(options, "bad"))


def reason(url: str, asked: int = 1, **given: Any) -> str:
    """Return why a driver isn't loaded, ended, or doesn't drive its last plan; empty: it does."""
    one = drives(url, **given)
    try:
        if one.problem:
            return one.problem
        for k in range(asked):
            last = question(k + 1)
            got = one.give(last)
        if got.answer is None:
            return got.ended
        if got.answer.trajectory is None:
            return got.answer.refused
        plan = plan_of(got.answer.trajectory, last.pose, last.stamp_ns, 0.01, "p", "v")
        return "" if isinstance(plan, MapPlan) else plan
    finally:
        one.close()


@pytest.mark.parametrize("call", [*CALLS, "close_session"])
def test_a_server_that_hangs_is_waited_for_up_to_the_deadline(
    call: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    own, release = EgodriverDriver._call, threading.Event()

    def hurried(self: EgodriverDriver, name: str, *rest: Any, **more: Any) -> Any:
        if name == call:
            self._budget = client._Budget(0.05)
        return own(self, name, *rest, **more)

    def hang(good: Any, request: Any, context: Any) -> Any:
        release.wait()
        return good(request, context)

    monkeypatch.setattr(EgodriverDriver, "_call", hurried)
    with serving(Bad(call, hang)) as url:
        try:
            why = reason(url)
        finally:
            release.set()
    if call == "close_session":
        assert why == ""
    else:
        assert why == f"gave no answer to {call} within its deadline_s of 0.05 s"


@pytest.mark.parametrize("call", CALLS)
def test_a_server_that_dies_has_died(call: str) -> None:
    server = grpc.server(futures.ThreadPoolExecutor(4))

    def die(_good: Any, _request: Any, _context: Any) -> Any:
        server.stop(None).wait()
        return proto.Empty()

    proto.add_EgodriverServiceServicer_to_server(Bad(call, die), server)  # type: ignore[no-untyped-call] # no types
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    assert reason(f"grpc://127.0.0.1:{port}").startswith(f"{call} failed: ")


def _changed(change: Callable[[Any], None]) -> Bad:
    def answer(good: Any, request: Any, context: Any) -> Any:
        response = good(request, context)
        change(response)
        return response

    return Bad("drive", answer)


def _each(response: Any, change: Callable[[int, Any], None]) -> None:
    for k, one in enumerate(response.trajectory.poses):
        change(k, one)


def _no_numbers(response: Any) -> None:
    _each(response, lambda _k, one: setattr(one.pose.vec, "x", float("nan")))


def _many(count: int) -> Callable[[Any], None]:
    def fill(response: Any) -> None:
        one = proto.Trajectory(poses=[response.trajectory.poses[-1]]).SerializeToString()
        response.trajectory.MergeFromString(one * count)

    return fill


def _samples(response: Any) -> None:
    response.debug_info.sampled_trajectories.extend([proto.Trajectory()] * 65)


def _many_samples(response: Any) -> None:
    one = proto.Trajectory(poses=[response.trajectory.poses[-1]] * 2000)
    response.debug_info.sampled_trajectories.extend([one] * 64)


def _says(**value: Any) -> Callable[[Any], None]:
    def say(response: Any) -> None:
        response.debug_info.unstructured_debug_info = json.dumps(value).encode()

    return say


def _in_rig(response: Any) -> None:
    def move(k: int, one: Any) -> None:
        one.pose.vec.x, one.pose.vec.y = 1.0 * k, 0.0

    _each(response, move)


def _backwards(response: Any) -> None:
    times = [one.timestamp_us for one in response.trajectory.poses][::-1]
    _each(response, lambda k, one: setattr(one, "timestamp_us", times[k]))


def _seconds(response: Any) -> None:
    _each(response, lambda k, one: setattr(one, "timestamp_us", k))


def _huge(response: Any) -> None:
    response.debug_info.unstructured_debug_info = bytes(20 << 20)


BAD: dict[str, tuple[Callable[[Any], None], int, str]] = {
    "no numbers": (_no_numbers, 1, "invalid: non_finite"),
    "empty": (lambda response: response.trajectory.Clear(), 1, "not_ready"),
    "1,000,000 points": (_many(1_000_000), 1, "more than 16 MiB"),
    "20,000 points": (_many(20_000), 1, "points, at most 10000"),
    "too many points in all": (_many_samples, 1, "points in all, at most 87381"),
    "65 samples": (_samples, 1, "65 samples, at most 64"),
    "rig frame": (_in_rig, 9, "begins "),
    "time that goes back": (_backwards, 1, "timestamps"),
    "relative times": (_seconds, 1, "not_ready"),
    "a message of 20 MiB": (_huge, 1, "more than 16 MiB"),
    "the end": (lambda response: setattr(response, "terminate_session", True), 1, "it ended the"),
}


@pytest.mark.parametrize("kind", BAD)
def test_a_bad_answer_is_refused_with_its_reason(kind: str) -> None:
    change, asked, why = BAD[kind]
    with serving(_changed(change)) as url:
        assert why in reason(url, asked)


def test_a_policy_that_runs_out_of_memory_has_died() -> None:
    def exhaust(_good: Any, _request: Any, context: Any) -> Any:
        context.abort(grpc.StatusCode.RESOURCE_EXHAUSTED, "CUDA out of memory")

    with serving(Bad("drive", exhaust)) as url:
        assert reason(url) == "drive failed: RESOURCE_EXHAUSTED: CUDA out of memory"


@pytest.mark.parametrize("text", ["\ud800", "\x1b[31m", "a\x00b"])
def test_a_text_that_a_bag_or_a_terminal_does_not_take_is_left_out(text: str) -> None:
    for data in (json.dumps({"text": text}), json.dumps(text)):
        said = wire.debug_text(data.encode())
        assert (said.text, said.left_out) == ("", "not text: it has control characters")
    with serving(_changed(_says(text=text))) as url:
        assert reason(url) == ""


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan, 1e305])
@pytest.mark.parametrize("row", [0, 1, 2])
def test_no_value_of_a_plan_to_the_last_bit_ends_a_run(value: float, row: int) -> None:
    near = Trajectory((0.0, 1.0), (0.0, 8.0), (0.0, 0.0))
    rows = [list(near.t_s), list(near.x_m), list(near.y_m)]
    rows[row][1] = value
    with pytest.raises(ValueError, match="to the last bit has a value beyond"):
        exact.plan_in({"plan": rows}, near)


def test_a_session_whose_start_is_given_up_is_closed() -> None:
    closed = threading.Event()

    def lose(good: Any, request: Any, context: Any) -> Any:
        good(request, context)
        context.abort(grpc.StatusCode.UNAVAILABLE, "lost on its way")

    class Watched(Bad):
        def close_session(self, request: Any, context: Any) -> Any:
            closed.set()
            return super().close_session(request, context)

    with serving(Watched("start_session", lose)) as url:
        assert "lost on its way" in reason(url)
        assert closed.wait(DEADLINE_S)


def test_a_revision_that_is_not_spoken_here_is_refused_before_a_run() -> None:
    def version(_good: Any, _request: Any, context: Any) -> Any:
        context.send_initial_metadata((("carla-driver-interface-contract", "3"),))
        return proto.VersionId()

    with serving(Bad("get_version", version)) as url:
        assert "revision 3" in reason(url)
        assert "1, 2 are spoken here" in reason(url)


def test_a_policy_that_wants_other_cameras_says_so() -> None:
    def refuse(_good: Any, _request: Any, context: Any) -> Any:
        context.abort(grpc.StatusCode.FAILED_PRECONDITION, "needs camera_left and camera_right")

    with serving(Bad("start_session", refuse)) as url:
        assert reason(url) == (
            "start_session failed: FAILED_PRECONDITION: needs camera_left and camera_right"
        )


def test_tls_and_plain_text_do_not_meet(tmp_path: Path) -> None:
    certificate = tmp_path / "certificate.pem"
    certificate.write_text(CERTIFICATE)
    server = grpc.server(futures.ThreadPoolExecutor(4))
    proto.add_EgodriverServiceServicer_to_server(Straight(), server)  # type: ignore[no-untyped-call] # no types
    pair = (KEY.encode(), CERTIFICATE.encode())
    port = server.add_secure_port("127.0.0.1:0", grpc.ssl_server_credentials([pair]))
    server.start()
    url = f"grpc://127.0.0.1:{port}"
    assert reason(url, tls=str(certificate)) == ""
    assert reason(url).startswith("get_version failed: UNAVAILABLE")
    server.stop(None).wait()
    with serving(Straight()) as plain:
        said = reason(plain, tls=str(certificate))
    assert said.startswith("get_version failed: UNAVAILABLE")
    missing = reason(url, tls=str(tmp_path / "none.pem"))
    assert "No such file" in missing
    (tmp_path / "none.pem").write_text("no certificate")
    assert "holds no certificate that can be read" in reason(url, tls=str(tmp_path / "none.pem"))


@pytest.fixture(scope="module")
def start(tmp_path_factory: pytest.TempPathFactory) -> Start:
    made = tmp_path_factory.mktemp("bad") / "cut_in"
    compiled = prepare_run("cut_in", "boulevard", made, seed=1, mode="lockstep")
    small = compiled.model_copy(update={"camera": SMALL})
    return make_start(small, load_event("cut_in")[0], 1, latency_max_s=0.5)


def run_of(start: Start, url: str) -> RunSpec:
    given = {"backend": "egodriver", "url": url, "deadline_s": PATIENT_S}
    return start.driven_by("bad", driver_options("bad", given), Latency(0.2))


def _from(count: int, then: Callable[..., Any]) -> Bad:
    """A policy that is bad from its answer of a number on."""
    asked = 0

    def answer(good: Any, request: Any, context: Any) -> Any:
        nonlocal asked
        asked += 1
        return then(good, request, context) if asked > count else good(request, context)

    return Bad("drive", answer)


def _too_late(_good: Any, _request: Any, context: Any) -> Any:
    """Answer as a client sees a policy that hangs, without the wait."""
    context.abort(grpc.StatusCode.DEADLINE_EXCEEDED, "")


def _is_gone(_good: Any, _request: Any, context: Any) -> Any:
    """Answer as a client sees a server that dies."""
    context.abort(grpc.StatusCode.UNAVAILABLE, "Socket closed")


def _is_too_large(_good: Any, _request: Any, context: Any) -> Any:
    """Answer as a client sees an oversized answer that it refuses, without making one."""
    words = "Received message larger than max (1073741824 vs. 16777216)"
    context.abort(grpc.StatusCode.RESOURCE_EXHAUSTED, words)


def _fails(_good: Any, _request: Any, context: Any) -> Any:
    context.abort(grpc.StatusCode.INTERNAL, "CUDA out of memory")


@pytest.mark.parametrize(
    ("servicer", "kinds", "why"),
    [
        (_from(10, _fails), ("died",), "drive failed: INTERNAL: CUDA out of memory"),
        (_from(10, _too_late), ("died",), "no answer to drive within its deadline_s of 600 s"),
        (_from(10, _is_gone), ("died",), "drive failed: UNAVAILABLE: Socket closed"),
        (_from(0, _is_too_large), ("fallback", "evaded"), "more than 16 MiB"),
        (_changed(BAD["the end"][0]), ("died",), "it ended the session (terminate_session)"),
        (_changed(_no_numbers), ("fallback", "evaded"), "invalid: non_finite"),
        (_changed(BAD["empty"][0]), ("fallback", "evaded"), "not_ready"),
        (_changed(_in_rig), ("fallback", "evaded", "left_road"), "begins "),
    ],
    ids=["fails", "hangs", "dies", "too large", "ends", "no numbers", "empty", "rig frame"],
)
def test_a_run_ends_with_its_verdict_whatever_the_server_does(
    servicer: Bad, kinds: tuple[str, ...], why: str, start: Start
) -> None:
    with serving(servicer) as url:
        run = run_of(start, url)
        result, record = run_in_process(run)
    assert run.driven is not None
    outcome = outcome_of(run, run.driven, result, record, start.twin)
    # A driver that died is a lost participant, whoever it is.
    ended = outcome.kind == "died"
    assert result.verdict == (Verdict.INVALID_HARNESS if ended else Verdict.VALID)
    assert outcome.kind in kinds, outcome
    answered = [one.drive.effective_answer for one in record.reports if one.drive is not None]
    refused = {one.refused for one in answered if one is not None}
    assert why in outcome.why or any(why in one for one in refused), (outcome, refused)
