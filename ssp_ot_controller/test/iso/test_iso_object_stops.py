"""SSP's own ISO 22133 object stops: aborts, silence, other centres, and whatever comes."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import ControlState
from ssp_ot_controller.bodies.iso22133.messages import (
    CentreStatus,
    ObjectCommand,
    Ostm,
    ResponseCode,
)
from ssp_ot_controller.rehearsal.played import PUT_BACK_S
from tests.support.iso22133.centre import Centre, S, played_object, rules_of, way_m
from tests.support.iso22133.driving import TRAJ, bound_m, driving, stop_way_m
from tests.support.iso22133.messages import messages

OK = ResponseCode.OK


# -- stopping -------------------------------------------------------------------------------------


def test_an_abort_stops_it_and_is_latched_until_it_is_cleared() -> None:
    centre = driving()
    limit_m = bound_m(centre, 0.02)
    centre.status = CentreStatus.ABORT
    centre.run(0.02)
    assert (centre.monr.state, centre.monr.error_status) == (ControlState.ABORTING, 0)
    assert centre.command(ObjectCommand.ALL_CLEAR) == ResponseCode.GENERAL_ERROR
    assert stop_way_m(centre) <= limit_m
    centre.status = CentreStatus.READY
    centre.run(1.0)
    assert centre.monr.state == ControlState.ABORTING
    assert centre.command(ObjectCommand.ARM) == ResponseCode.GENERAL_ERROR
    assert centre.command(ObjectCommand.ALL_CLEAR) == OK
    centre.run(0.05)
    assert centre.monr.state == ControlState.DISARMED


def test_a_centre_that_dies_while_it_drives_stops_it_within_its_stop_way() -> None:
    """It stops after the OSEM's timeout, shorter than its own; then it waits for another centre."""
    centre = driving()
    limit_m = bound_m(centre, 0.2 + 0.01)
    centre.status = None
    assert stop_way_m(centre) <= limit_m
    assert centre.monr.error_code == SafetyCode.HEARTBEAT_LOST
    centre.run(1.6)
    assert (centre.monr.state, centre.monr.speed_mps) == (ControlState.ABORTING, 0.0)
    assert centre.played.state is ControlState.INIT
    other = Centre(centre.played, "10.0.0.2")
    other.now_ns = centre.now_ns
    other.connect()
    assert other.monr.state == ControlState.DISARMED


def test_an_abort_while_it_brakes_for_silence_is_latched() -> None:
    centre = driving()
    centre.status = None
    centre.run(0.3)
    centre.status = CentreStatus.ABORT
    centre.run(0.1)
    centre.status = CentreStatus.READY
    stop_way_m(centre)
    centre.run(0.5)
    assert centre.monr.state == ControlState.ABORTING


def test_a_connection_that_is_lost_while_it_drives_stops_it_at_once() -> None:
    centre = driving()
    limit_m = bound_m(centre, 0.01)
    centre.played.disconnect(centre.now_ns)
    assert centre.played.state is ControlState.ABORTING
    assert stop_way_m(centre) <= limit_m
    centre.run(1.6)
    assert centre.played.state is ControlState.INIT


def test_an_abort_outlives_the_connection() -> None:
    centre = driving()
    centre.status = CentreStatus.ABORT
    centre.run(0.1)
    centre.played.disconnect(centre.now_ns)
    stop_way_m(centre)
    centre.status = CentreStatus.INIT
    centre.connect()
    assert centre.monr.state == ControlState.ABORTING


def test_silence_while_it_is_armed_disarms_it() -> None:
    centre = Centre(played_object()).armed(TRAJ)
    centre.status = None
    centre.run(0.5)
    assert centre.played.state is ControlState.INIT


def test_a_start_that_waits_ends_with_the_heartbeats() -> None:
    centre = Centre(played_object()).armed(TRAJ)
    centre.start(0.23)
    centre.status = None
    centre.run(1.0)
    assert (centre.played.started_ns, centre.played.body.x_m) == (None, 0.0)


def test_its_own_bound_counts_where_the_osem_allows_more() -> None:
    centre = Centre(played_object(heartbeat_s=0.5))
    centre.connect({"heab_timeout_s": 600.0})
    centre.status = None
    assert centre.run(5.0, until=lambda: centre.played.state is ControlState.INIT) < 0.6


def test_a_timeout_shorter_than_three_heartbeats_is_taken_for_these() -> None:
    """A public control centre asks for 20 ms and sends a heartbeat every 100 ms."""
    centre = Centre(played_object())
    centre.connect({"heab_timeout_s": 0.02, "heab_rate_hz": 10})
    centre.status = None
    took_s = centre.run(5.0, until=lambda: centre.played.state is ControlState.INIT)
    assert 0.25 < took_s < 0.4


# -- one control centre ---------------------------------------------------------------------------


def test_a_second_control_centre_is_neither_connected_nor_heard() -> None:
    centre = driving()
    assert not centre.played.connect("10.0.0.9", centre.now_ns)
    stranger = Centre(centre.played, "10.0.0.9")
    stranger.now_ns = centre.now_ns
    stranger.beat(CentreStatus.ABORT)
    other_port = Centre(centre.played)
    other_port.address, other_port.now_ns = (centre.address[0], 50_001), centre.now_ns
    other_port.beat(CentreStatus.ABORT)
    centre.run(0.1)
    assert centre.monr.state == ControlState.RUNNING
    assert centre.played.link.strangers == 2


def started_without_a_trajectory(centre: Centre) -> Centre:
    centre.armed(None)
    centre.start()
    centre.status = CentreStatus.RUNNING
    centre.run(3.0)
    return centre


def test_what_another_centre_sent_isnt_driven() -> None:
    first = Centre(played_object()).armed(TRAJ)
    first.played.disconnect(first.now_ns)
    other = Centre(first.played, "10.0.0.2")
    other.now_ns = first.now_ns
    started_without_a_trajectory(other)
    assert (other.monr.state, other.monr.speed_mps) == (ControlState.RUNNING, 0.0)


# -- whatever comes -------------------------------------------------------------------------------


@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    st.lists(
        st.one_of(
            st.tuples(st.just("tcp"), messages | st.binary(max_size=60)),
            st.tuples(st.just("udp"), messages | st.binary(max_size=60)),
            st.tuples(st.just("time"), st.floats(0.0, 0.6)),
            st.tuples(st.just("link"), st.booleans()),
        ),
        max_size=12,
    )
)
def test_nothing_that_comes_ends_it_or_moves_it_after_an_abort(
    steps: list[tuple[str, Any]],
) -> None:
    centre = driving(for_s=1.0)
    centre.status = CentreStatus.ABORT
    centre.run(0.05)
    for kind, what in steps:
        now_ns = centre.now_ns
        if kind == "time":
            centre.run(what)
        elif kind == "link":
            centre.played.disconnect(now_ns)
            if what:
                centre.played.connect(centre.address[0], now_ns)
        elif what == Ostm(ObjectCommand.ALL_CLEAR):
            continue
        else:
            data = what if isinstance(what, bytes) else centre.frame(what, acknowledge=True)
            if kind == "tcp":
                centre.played.on_tcp(data, now_ns)
            else:
                centre.played.on_udp(data, centre.address, now_ns)
    stop_way_m(centre)
    stands = centre.played.body
    centre.run(0.5)
    assert way_m(stands, centre.played.body) == 0.0
    assert centre.played.state is ControlState.ABORTING


@pytest.mark.parametrize("status", [CentreStatus.NORMAL_STOP, CentreStatus.ABORT])
def test_left_alone_it_goes_back_to_its_start_and_can_be_armed_again(status: CentreStatus) -> None:
    centre = driving(for_s=3.0)
    played = centre.played
    centre.status = status
    centre.run(0.05)
    stop_way_m(centre)
    assert not played.put_back()  # while a centre is connected
    played.disconnect(centre.now_ns)
    played.advance(centre.now_ns + round((PUT_BACK_S - 1.0) * S))
    assert not played.put_back()
    assert played.body.x_m > 1.0
    now_ns = centre.now_ns + round((PUT_BACK_S + 10.0) * S)
    played.advance(now_ns)
    assert played.put_back()
    assert not played.put_back()
    assert way_m(rules_of().spec.start, played.body) == 0.0
    again = Centre(played)
    again.now_ns = now_ns
    again.connect()
    again.send(TRAJ)
    again.status = CentreStatus.READY
    assert again.command(ObjectCommand.ARM) == OK


@pytest.mark.parametrize(
    ("status", "goes_back"),
    [
        (CentreStatus.NORMAL_STOP, True),
        (CentreStatus.TEST_DONE, True),
        (CentreStatus.ABORT, True),
        (CentreStatus.INIT, True),
        (CentreStatus.RUNNING, False),
        (CentreStatus.READY, False),
    ],
)
def test_the_next_centre_finds_it_at_its_start_and_one_that_was_cut_off_where_it_stopped(
    status: CentreStatus, goes_back: bool
) -> None:
    centre = driving(for_s=3.0)
    played = centre.played
    if goes_back:
        centre.status = CentreStatus.NORMAL_STOP if status is not CentreStatus.ABORT else status
        centre.run(0.05)
        assert not played.put_back(is_called=True)  # while it is connected
        stop_way_m(centre)
        centre.status = status
        centre.run(0.1)
    else:
        centre.status = status
        centre.run(0.05)
    played.disconnect(centre.now_ns)
    moves = played.body.speed_mps > 0.0
    assert moves is not goes_back
    if moves:
        assert not played.put_back(is_called=True)
        played.advance(centre.now_ns + 6 * S)
    assert played.body.speed_mps == 0.0
    assert not played.put_back()
    assert played.put_back(is_called=True) is goes_back
    assert (way_m(rules_of().spec.start, played.body) == 0.0) is goes_back
