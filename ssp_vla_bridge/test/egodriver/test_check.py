"""``ssp driver check``: each part fails for the policy that has its fault, and for no other."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import grpc  # type: ignore[import-untyped] # has no types
import pytest
from carla_driver_interface import protocol as proto
from click.testing import CliRunner

from ssp_core.errors import InputError
from ssp_eval.evaluate.drivers_cli import driver
from ssp_vla_bridge.egodriver import check
from ssp_vla_bridge.egodriver.options import read_options
from tests.support.models.egodrivers import Straight, nobody, serving
from tests.support.self_signed import KEY


class Sound(Straight):
    """A policy that keeps its speed in each session."""

    def of_session(self, call: str, session: str) -> list[Any]:
        return [one for one in self.sent(call) if one.session_uuid == session]

    def answer(self, request: Any) -> Any:
        return self.planned(request, request.session_uuid)

    def planned(self, request: Any, session: str) -> Any:
        motion = self.of_session("submit_egomotion_observation", session)[-1]
        last, speed_mps = motion.trajectory.poses[-1], motion.dynamic_states[-1].linear_velocity.x
        yaw = 2.0 * math.atan2(last.pose.quat.z, last.pose.quat.w)
        plan = proto.Trajectory()
        for k in range(1, 31):
            way_m = 0.1 * k * speed_mps
            x, y = last.pose.vec.x + way_m * math.cos(yaw), last.pose.vec.y + way_m * math.sin(yaw)
            pose = proto.Pose(vec=proto.Vec3(x=x, y=y), quat=last.pose.quat)
            at_us = request.time_now_us + 100_000 * k
            plan.poses.append(proto.PoseAtTime(pose=pose, timestamp_us=at_us))
        return proto.DriveResponse(trajectory=plan)


class InRig(Sound):
    def answer(self, request: Any) -> Any:
        response = super().answer(request)
        for k, one in enumerate(response.trajectory.poses):
            one.pose.vec.x, one.pose.vec.y = 0.8 * (k + 1), 0.0
        return response


class Silent(Sound):
    def answer(self, request: Any) -> Any:
        return proto.DriveResponse()


class Short(Sound):
    def answer(self, request: Any) -> Any:
        response = super().answer(request)
        del response.trajectory.poses[15:]
        return response


class Ends(Sound):
    """It ends a session at its seventh call; two short ones of one name have six."""

    def answer(self, request: Any) -> Any:
        response = super().answer(request)
        asked = len(self.of_session("drive", request.session_uuid))
        response.terminate_session = asked > 6
        return response


class OneState(Sound):
    """It takes the motion of the session that began first among those that are open."""

    def answer(self, request: Any) -> Any:
        began = [name for name, _, _ in self.calls].count("start_session")
        ended = [name for name, _, _ in self.calls].count("close_session")
        # Sessions of this check end in the order in which they began.
        oldest = self.sent("start_session")[min(ended, began - 1)].session_uuid
        moved = {one.session_uuid for one in self.sent("submit_egomotion_observation")}
        return self.planned(request, oldest if oldest in moved else request.session_uuid)


class ByRoute(Sound):
    """It plans to where its route leads, whatever that is."""

    def answer(self, request: Any) -> Any:
        response = super().answer(request)
        last = self.of_session("submit_route", request.session_uuid)[-1].route.waypoints[-1]
        for one in response.trajectory.poses:
            one.pose.vec.x += 0.0 * last.x
        return response


@pytest.mark.parametrize(
    ("policy", "failed"),
    [
        (Sound, set()),
        (InRig, {"frames"}),
        (Silent, {"answers"}),
        (Short, {"answers"}),
        (Ends, {"answers", "terminate"}),
        (OneState, {"sessions"}),
        (ByRoute, {"route"}),
    ],
)
def test_each_part_finds_its_fault(policy: type[Sound], failed: set[str]) -> None:
    with serving(policy()) as url:
        found = check.check_policy(read_options({"url": url, "deadline_s": 600.0}, "check"))
    # A busy machine may take longer than any bound for a call.
    judged = [one for one in found if one.name != "latency"]
    assert {one.name for one in judged if not one.passed} >= failed
    ours = failed | ({"sessions"} if policy is InRig else set())
    assert {one.name for one in judged if not one.passed} <= ours
    assert all(bool(one.mend) != one.passed and one.seen for one in found)
    assert len(found) == 7


class Crashes(Sound):
    def drive(self, request: Any, context: Any) -> Any:
        context.abort(grpc.StatusCode.INTERNAL, "CUDA out of memory")


class OneSession(Sound):
    """It takes one session at a time."""

    def start_session(self, request: Any, context: Any) -> Any:
        names = [name for name, _, _ in self.calls]
        if names.count("start_session") > names.count("close_session"):
            context.abort(grpc.StatusCode.RESOURCE_EXHAUSTED, "one at a time")
        return super().start_session(request, context)


class Hangs(Sound):
    """It gives no answer before the client's deadline."""

    def drive(self, request: Any, context: Any) -> Any:
        context.abort(grpc.StatusCode.DEADLINE_EXCEEDED, "")


@pytest.mark.parametrize(
    ("policy", "part", "seen", "mend"),
    [
        (Ends, "terminate", "it ended the session", "leave terminate_session unset"),
        (Crashes, "terminate", "INTERNAL: CUDA out of memory", "mend what its server says"),
        (Crashes, "frames", "INTERNAL: CUDA out of memory", "mend what its server says"),
        (OneSession, "sessions", "RESOURCE_EXHAUSTED: one at a time", "take 8 sessions at once"),
        (Hangs, "frames", "no answer to drive within its deadline_s", "--deadline here"),
        (Hangs, "terminate", "no answer to drive within its deadline_s", "--deadline here"),
        (Hangs, "latency", "only 0 of 20 calls were answered", "--deadline here"),
        (Ends, "latency", "only 6 of 20 calls were answered", "see terminate"),
        (Silent, "answers", "20 of 20 answers without a plan", "answer each call"),
    ],
)
def test_what_is_to_be_mended_is_what_was_wrong(
    policy: type[Sound], part: str, seen: str, mend: str
) -> None:
    with serving(policy()) as url:
        found = check.check_policy(read_options({"url": url, "deadline_s": 600.0}, "check"))
    (one,) = [one for one in found if one.name == part]
    assert not one.passed
    assert seen in one.seen
    assert mend in one.mend


def test_a_wrong_file_of_certificates_is_refused_before_anything_is_asked(tmp_path: Path) -> None:
    (tmp_path / "key.pem").write_text(KEY)
    for name, why in (("none.pem", "can't be read: No such file"), ("key.pem", "no certificate")):
        given = ["check", "grpc://127.0.0.1:1", "--tls", str(tmp_path / name)]
        done = CliRunner().invoke(driver, given)
        with pytest.raises(InputError, match=f"--tls: .*{why}"):
            raise done.exception or AssertionError(done.output)


def test_a_slow_policy_is_told_by_its_latency(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(check, "_BOUND_S", 0.0)
    with serving(Sound()) as url:
        done = CliRunner().invoke(
            driver, ["check", url, "--json", "--deadline", "600"], standalone_mode=False
        )
    (slow,) = [one for one in json.loads(done.output) if not one["passed"]]
    assert slow["name"] == "latency"
    assert "of 20 calls" in slow["seen"]
    assert "--latency measured:S" in slow["mend"]
    assert done.return_value == 1


def test_nobody_there_is_the_only_finding() -> None:
    with nobody() as url:
        done = CliRunner().invoke(driver, ["check", url], standalone_mode=False)
    assert done.return_value == 1
    assert "fail  version" in done.output
    assert "mend: start the server" in done.output
    assert "pass" not in done.output
