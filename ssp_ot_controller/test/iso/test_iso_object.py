"""SSP's own ISO 22133 object under a control centre, by given times: every transition."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import ssp_core
from ssp_core.geodesy import Datum
from ssp_core.geometry import Polyline
from ssp_core.motion.manoeuvre import drive_along
from ssp_core.motion.reference import Reference, ReferencePoint, sample
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import ControlState
from ssp_ot_controller.bodies.iso22133.framing import Header, pack_frame
from ssp_ot_controller.bodies.iso22133.messages import (
    CentreStatus,
    Dreq,
    Dres,
    Message,
    ObjectCommand,
    ObjectError,
    Opaque,
    ResponseCode,
    Strt,
    TrajectoryInfo,
)
from ssp_ot_controller.rehearsal.iso_object import HEAB_LAG_S, STEP_S, IsoObject
from tests.support.iso22133.centre import (
    PLACE,
    T0,
    Centre,
    S,
    osem,
    played_object,
    rules_of,
    trajectory,
    way_m,
)
from tests.support.iso22133.driving import STRAIGHT, TRAJ, driving, stop_way_m

OK = ResponseCode.OK
STANDING = [ReferencePoint(t, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0) for t in (0.0, 1.0)]


# -- driving --------------------------------------------------------------------------------------


def test_it_drives_a_trajectory_within_a_decimetre() -> None:
    bend = [(150.0 * math.sin(a), 150.0 * (1.0 - math.cos(a))) for a in np.linspace(0.0, 0.4, 61)]
    points = drive_along(Polyline(bend), 0.0, 0.0, 8.0, 2.0, 2.0)
    centre = Centre(played_object()).driving(trajectory(points), 0.0)
    reference = Reference("", "ot1", "", "", 0, centre.played.started_ns or 0, 0, tuple(points))
    worst_m = 0.0
    while centre.now_ns < reference.end_ns:
        centre.run(0.05)
        worst_m = max(worst_m, way_m(sample(reference, centre.now_ns), centre.played.body))
    assert worst_m < 0.1
    assert (centre.monr.x_m, centre.monr.y_m) == pytest.approx(bend[-1], abs=0.1)
    assert centre.monr.state == ControlState.RUNNING


def test_a_run_goes_from_init_to_disarmed_again() -> None:
    played = played_object()
    assert played.state is ControlState.INIT
    centre = Centre(played)
    centre.connect()
    assert (centre.monr.state, centre.monr.ready_to_arm) == (ControlState.DISARMED, 1)
    centre.send(TRAJ)
    centre.status = CentreStatus.READY
    assert centre.command(ObjectCommand.ARM) == OK
    centre.run(0.05)
    assert (centre.monr.state, centre.monr.ready_to_arm) == (ControlState.ARMED, 0)
    assert centre.start() == OK
    centre.status = CentreStatus.RUNNING
    centre.run(3.0)
    assert centre.monr.state == ControlState.RUNNING
    assert centre.monr.speed_mps == pytest.approx(5.0, abs=1.0)
    centre.status = CentreStatus.NORMAL_STOP
    centre.run(0.05)
    assert centre.monr.state == ControlState.POSTRUN
    centre.run(5.0)
    assert (centre.monr.state, centre.monr.speed_mps) == (ControlState.DISARMED, 0.0)
    assert centre.monr.error_status == 0
    centre.status = CentreStatus.INIT
    centre.run(0.1)
    assert centre.monr.state == ControlState.DISARMED


def test_what_it_reports_lies_in_the_frame_of_the_osem() -> None:
    """The site is turned and its datum lies elsewhere: the centre knows nothing of that."""
    site = Datum(PLACE, yaw_rad=0.5)
    elsewhere = Datum(site.to_place(30.0, -40.0))
    centre = Centre(IsoObject(rules_of(), T0, site))
    place = elsewhere.place
    centre.connect({"latitude_deg": place.latitude_deg, "longitude_deg": place.longitude_deg})
    expected = elsewhere.to_site(site.to_place(0.0, 0.0))
    assert (centre.monr.x_m, centre.monr.y_m) == pytest.approx(expected[:2], abs=0.002)
    assert centre.monr.yaw_rad == pytest.approx(0.5, abs=1e-3)
    x, y = expected[:2]
    ahead = [(x + s * math.cos(0.5), y + s * math.sin(0.5)) for s in (0.0, 100.0)]
    traj = trajectory(drive_along(Polyline(ahead), 0.0, 0.0, 8.0, 2.0, 2.0), datum=elsewhere)
    assert centre.send(traj).response == OK
    centre.status = CentreStatus.READY
    centre.run(0.1)
    centre.command(ObjectCommand.ARM)
    centre.run(0.1)
    centre.start()
    centre.status = CentreStatus.RUNNING
    centre.run(30.0)
    body = centre.played.body
    assert (body.x_m, body.y_m) == pytest.approx((100.0, 0.0), abs=0.1)


@pytest.mark.parametrize("in_s", [0.3, 1.0, 2.7183])
def test_a_start_time_is_kept_to_a_step(in_s: float) -> None:
    centre = Centre(played_object()).armed(TRAJ)
    asked_ns = centre.now_ns + round(in_s * S)
    assert centre.start(in_s) == OK
    centre.status = CentreStatus.RUNNING
    centre.run(10.0, until=lambda: centre.monr.state == ControlState.RUNNING)
    began_ns = centre.played.started_ns or 0
    assert abs(began_ns - asked_ns) <= STEP_S * S
    assert 0 <= centre.now_ns - asked_ns <= 0.02 * S


@pytest.mark.parametrize("in_s", [None, -5.0])
def test_without_a_start_time_or_with_a_past_one_it_starts_at_once(in_s: float | None) -> None:
    centre = Centre(played_object()).armed(TRAJ)
    assert centre.start(in_s) == OK
    centre.run(0.02)
    assert centre.monr.state == ControlState.RUNNING


def test_times_count_from_a_start_that_came_a_little_late() -> None:
    centre = Centre(played_object()).armed(TRAJ)
    asked_ns = centre.now_ns - round(0.1 * S)
    assert centre.start(-0.1) == OK
    centre.status = CentreStatus.RUNNING
    centre.run(10.0)
    reference = Reference("", "ot1", "", "", 0, asked_ns, 0, tuple(STRAIGHT))
    assert way_m(sample(reference, centre.now_ns), centre.played.body) < 0.1


def test_a_start_of_another_week_is_refused() -> None:
    centre = Centre(played_object()).armed(TRAJ)
    assert centre.send(Strt(0, 1)).response == ResponseCode.INVALID_DATA


@pytest.mark.parametrize(
    "status", [CentreStatus.INIT, CentreStatus.NORMAL_STOP, CentreStatus.TEST_DONE]
)
def test_a_start_that_waits_is_taken_back_by_a_heartbeat(status: CentreStatus) -> None:
    centre = Centre(played_object()).armed(TRAJ)
    centre.start(0.5)
    centre.status = status
    centre.run(0.1)
    centre.status = CentreStatus.READY
    centre.run(1.0)
    assert centre.monr.state == ControlState.ARMED


def test_heartbeats_that_lag_behind_the_start_are_borne_for_a_while() -> None:
    centre = Centre(played_object()).armed(TRAJ)
    centre.start()
    centre.run(HEAB_LAG_S - 0.1)
    assert centre.monr.state == ControlState.RUNNING
    centre.run(0.2)
    assert centre.monr.state == ControlState.ABORTING


# -- trajectories ---------------------------------------------------------------------------------


def elsewhere() -> Message:
    return trajectory(drive_along(Polyline([(5.0, 0.0), (200.0, 0.0)]), 0.0, 0.0, 8.0, 2.0, 2.0))


@pytest.mark.parametrize(
    ("traj", "code"),
    [
        (elsewhere(), ResponseCode.INVALID_DATA),
        (trajectory(STRAIGHT[:100]), ResponseCode.INVALID_DATA),
        (replace(TRAJ, info=TrajectoryInfo.RELATIVE_TO_OBJECT), ResponseCode.NOT_SUPPORTED),
        (replace(TRAJ, line_info=1), ResponseCode.NOT_SUPPORTED),
        (replace(TRAJ, points=TRAJ.points[:1]), ResponseCode.INVALID_DATA),
    ],
    ids=["begins elsewhere", "ends while moving", "relative to the object", "a chunk", "a point"],
)
def test_a_trajectory_is_checked_before_it_is_armed(traj: Message, code: ResponseCode) -> None:
    """And nothing is armed with one that it had before, nor with none."""
    centre = Centre(played_object())
    centre.connect()
    assert centre.send(TRAJ).response == OK
    assert centre.send(traj).response == code
    centre.run(0.05)
    assert centre.monr.ready_to_arm == 0
    assert centre.command(ObjectCommand.ARM) == ResponseCode.GENERAL_ERROR
    assert centre.send(TRAJ).response == OK
    assert centre.command(ObjectCommand.ARM) == OK


def test_what_was_driven_isnt_driven_again_from_elsewhere() -> None:
    centre = driving()
    centre.status = CentreStatus.TEST_DONE
    stop_way_m(centre)
    centre.run(0.1)
    centre.status = CentreStatus.READY
    assert centre.command(ObjectCommand.ARM) == ResponseCode.GENERAL_ERROR
    assert "position jumps by" in centre.played.link.notes[-1]


def test_a_deleted_trajectory_isnt_driven() -> None:
    centre = Centre(played_object())
    centre.connect()
    centre.send(TRAJ)
    assert centre.send(replace(TRAJ, info=TrajectoryInfo.DELETE, points=())).response == OK
    centre.status = CentreStatus.READY
    centre.run(0.05)
    centre.command(ObjectCommand.ARM)
    centre.run(0.05)
    centre.start()
    centre.run(0.4)
    assert (centre.monr.state, centre.played.body.speed_mps) == (ControlState.RUNNING, 0.0)


def ahead_of(centre: Centre, in_s: float) -> Message:
    """Return a trajectory from its place in so many seconds to a standstill."""
    began_ns = centre.played.started_ns or 0
    at_ns = centre.now_ns - began_ns + round(in_s * S)
    at_ns -= at_ns % 50_000_000
    reference = Reference("", "ot1", "", "", 0, 0, 0, tuple(STRAIGHT))
    there = sample(reference, at_ns)
    path = Polyline([(0.0, 0.0), (200.0, 0.0)])
    points = drive_along(path, there.x_m, there.speed_mps, 3.0, 2.0, 2.0)
    return trajectory(points, at_ns)


def test_a_trajectory_that_comes_while_it_runs_replaces_from_its_first_point_on() -> None:
    centre = driving(for_s=6.0)
    assert centre.send(ahead_of(centre, 0.5)).response == OK
    centre.run(0.4)
    assert centre.monr.speed_mps == pytest.approx(8.0, abs=0.1)
    centre.run(5.0)
    assert centre.monr.speed_mps == pytest.approx(3.0, abs=0.1)
    assert centre.monr.state == ControlState.RUNNING


def test_of_a_whole_trajectory_that_comes_while_it_runs_the_past_isnt_looked_at() -> None:
    centre = driving(for_s=6.0)
    assert centre.send(TRAJ).response == OK
    centre.run(2.0)
    assert centre.monr.speed_mps == pytest.approx(8.0, abs=0.1)


def test_a_trajectory_that_cant_be_driven_while_it_runs_stops_it() -> None:
    centre = driving(for_s=6.0)
    assert centre.send(elsewhere()).response == ResponseCode.INVALID_DATA
    centre.run(0.05)
    assert centre.monr.state == ControlState.ABORTING
    assert centre.monr.error_code == SafetyCode.REFERENCE_REFUSED
    assert centre.monr.error_status & ObjectError.ABORT_REQUEST
    stop_way_m(centre)
    assert centre.command(ObjectCommand.ALL_CLEAR) == ResponseCode.GENERAL_ERROR
    # It is known to stand once it has stood for a second.
    centre.run(1.0)
    assert centre.command(ObjectCommand.ALL_CLEAR) == OK
    centre.run(0.05)
    assert (centre.monr.error_code, centre.monr.error_status) == (0, 0)


def test_trajectories_while_it_runs_need_the_test_mode_online() -> None:
    centre = Centre(played_object())
    centre.connect({"test_mode": 0})
    centre.send(TRAJ)
    centre.status = CentreStatus.READY
    centre.run(0.05)
    centre.command(ObjectCommand.ARM)
    centre.run(0.05)
    centre.start()
    centre.status = CentreStatus.RUNNING
    centre.run(3.0)
    assert centre.send(ahead_of(centre, 0.5)).response == ResponseCode.GENERAL_ERROR
    assert centre.monr.state == ControlState.RUNNING


# -- settings and answers -------------------------------------------------------------------------


@pytest.mark.parametrize(
    "changes",
    [
        {"monr_rate_hz": 0},
        {"heab_rate_hz": 0},
        {"heab_timeout_s": 0.0},
        {"max_way_deviation_m": 0.0},
        {"leap_seconds": 19},
        {"rotation_rad": 0.5},
        {"latitude_deg": None},
        {"origin": PLACE.longitude_deg + 1.0},
        {"coordinate_system": 1},
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_settings_that_cant_be_kept_are_refused(changes: dict[str, Any]) -> None:
    centre = Centre(played_object())
    asked = {name.replace("origin", "longitude_deg"): value for name, value in changes.items()}
    assert centre.connect(asked).response == ResponseCode.INVALID_DATA
    assert centre.monrs == []
    assert next(iter(changes)) in " ".join(centre.played.link.notes)
    assert centre.command(ObjectCommand.ARM) == ResponseCode.GENERAL_ERROR


@pytest.mark.parametrize("rate_hz", [1, 20, 100])
def test_it_reports_at_the_rate_of_the_osem(rate_hz: int) -> None:
    centre = Centre(played_object())
    centre.connect({"monr_rate_hz": rate_hz})
    before = len(centre.monrs)
    centre.run(2.0)
    assert len(centre.monrs) - before == 2 * rate_hz
    stamps = [monr.time_of_week_ns for monr in centre.monrs]
    assert len(set(stamps)) == len(stamps)


def test_a_deviation_larger_than_the_osem_allows_stops_it() -> None:
    """Its own bound is wider; the body is carried away as no centre sees it."""
    centre = Centre(played_object(jump_m=50.0, error_lateral_m=50.0))
    centre.driving(TRAJ, 4.0)
    body = centre.played.body
    centre.played.body = replace(body, y_m=body.y_m + 1.0)
    centre.run(0.05)
    assert centre.monr.error_code == SafetyCode.ERROR_LATERAL


def test_an_accuracy_that_it_doesnt_have_is_reported() -> None:
    centre = Centre(played_object())
    centre.connect({"max_position_error_m": 0.01})
    assert centre.monr.error_status == ObjectError.BAD_POSITIONING_ACCURACY
    assert centre.monr.ready_to_arm == 0


def test_outside_of_its_fence_it_says_so() -> None:
    centre = driving(jump_m=100.0)
    body = centre.played.body
    centre.played.body = replace(body, y_m=30.0)
    centre.run(0.05)
    assert centre.monr.state == ControlState.ABORTING
    bits = ObjectError.OUTSIDE_GEOFENCE | ObjectError.ABORT_REQUEST
    assert (centre.monr.error_status, centre.monr.error_code) == (
        bits,
        SafetyCode.OUTSIDE_GEOFENCE,
    )


def test_a_discovery_request_is_answered() -> None:
    centre = Centre(played_object())
    centre.connect()
    told = centre.send(Dreq(), acknowledge=False)
    assert told == Dres("SSP", "ssp iso object", ssp_core.__version__, "ot1", 0)


def test_only_who_asks_is_answered() -> None:
    centre = Centre(played_object())
    centre.connect()
    assert centre.send(TRAJ, acknowledge=False) is None
    answer = centre.send(TRAJ)
    assert (answer.transmitter_id, answer.message_id, answer.response) == (3, 1, OK)


@pytest.mark.parametrize(
    "message", [Opaque(0xA100, ()), Dres("v", "p", "f", "n", 0)], ids=["a vendor's", "a DRES"]
)
def test_messages_that_are_none_for_it_are_named(message: Message) -> None:
    centre = Centre(played_object())
    centre.connect()
    assert centre.send(message).response == ResponseCode.NOT_SUPPORTED


@pytest.mark.parametrize("state", ["init", "armed", "running", "postrun"])
def test_what_a_state_doesnt_allow_is_refused(state: str) -> None:
    centre = Centre(played_object())
    if state == "init":
        centre.played.connect(centre.address[0], centre.now_ns)
        refused = [centre.send(TRAJ), centre.send(Strt(None, None))]
    elif state == "armed":
        centre.armed(TRAJ)
        refused = [centre.send(osem(centre.now_ns))]
    elif state == "postrun":
        centre.driving(TRAJ, 3.0).status = CentreStatus.NORMAL_STOP
        centre.run(0.05)
        refused = [centre.send(TRAJ), centre.send(Strt(None, None))]
    else:
        centre.driving(TRAJ, 3.0)
        refused = [centre.send(osem(centre.now_ns)), centre.send(Strt(None, None))]
    assert {answer.response for answer in refused} == {ResponseCode.GENERAL_ERROR}


def test_arming_needs_heartbeats_and_disarming_takes_it_back() -> None:
    centre = Centre(played_object())
    centre.connect()
    centre.send(TRAJ)
    centre.status = None
    centre.run(0.1)
    centre.played.advance(centre.now_ns)
    centre.now_ns += round(0.05 * S)
    centre.status = CentreStatus.READY
    centre.run(0.1)
    assert centre.command(ObjectCommand.ARM) == OK
    centre.run(0.1)
    assert centre.command(ObjectCommand.DISARM) == OK
    centre.run(0.1)
    assert centre.monr.state == ControlState.DISARMED
    assert centre.command(ObjectCommand.ARM) == OK


def test_remote_control_is_refused() -> None:
    centre = Centre(played_object())
    centre.connect()
    assert centre.command(ObjectCommand.REMOTE_CONTROL) == ResponseCode.NOT_SUPPORTED


def test_damaged_bytes_are_told_and_what_follows_is_heard() -> None:
    centre = Centre(played_object())
    centre.connect()
    other = bytearray(centre.frame(TRAJ))
    other[6] = 3
    for data in (bytes(other), b"\x00\x7f", pack_frame(Header(0x7777, acknowledge=True), b"")):
        centre.played.on_tcp(data, centre.now_ns)
    assert any("version 3" in note for note in centre.played.link.notes)
    assert centre.send(TRAJ).response == OK


def test_a_frame_that_never_ends_is_given_up_with_time_or_connection() -> None:
    centre = Centre(played_object())
    centre.connect()
    centre.played.on_tcp(centre.frame(TRAJ)[:100], centre.now_ns)
    centre.run(1.6)
    assert centre.send(TRAJ).response == OK
    centre.played.on_tcp(centre.frame(TRAJ)[:100], centre.now_ns)
    centre.played.disconnect(centre.now_ns)
    assert centre.connect().response == OK
