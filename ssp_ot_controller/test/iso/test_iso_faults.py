"""Faults of a played ISO 22133 object, by given times: what the control centre sees of each."""

from __future__ import annotations

from typing import Any

import pytest

from ssp_core.errors import InputError
from ssp_core.geometry import Polyline
from ssp_core.motion.manoeuvre import drive_along
from ssp_core.vocabulary import ControlState
from ssp_ot_controller.bodies.iso22133.messages import CentreStatus, Dreq, Dres, Grem, Strt
from ssp_ot_controller.rehearsal.iso_faults import FaultyObject, IsoFault
from tests.support.iso22133.centre import Centre, played_object, trajectory, way_m

TRAJ = trajectory(drive_along(Polyline([(0.0, 0.0), (200.0, 0.0)]), 0.0, 0.0, 8.0, 2.0, 2.0))


def centre_of(*faults: str) -> Centre:
    return Centre(FaultyObject(played_object(), [IsoFault.parse(text) for text in faults]))


def driving(*faults: str, for_s: float = 5.0) -> Centre:
    return centre_of(*faults).driving(TRAJ, for_s)


def test_without_a_fault_nothing_is_changed() -> None:
    centre, plain = driving(), Centre(played_object()).driving(TRAJ, 5.0)
    assert centre.monrs == plain.monrs
    assert centre.refused == []


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("no_dres", IsoFault("no_dres")),
        ("link_delay=0.25", IsoFault("link_delay", 0.25)),
        ("link_cut@3", IsoFault("link_cut", at_s=3.0)),
        ("link_cut@3.5+0.5", IsoFault("link_cut", at_s=3.5, for_s=0.5)),
    ],
)
def test_faults_are_read(text: str, fault: IsoFault) -> None:
    assert IsoFault.parse(text) == fault


@pytest.mark.parametrize(
    "text", ["", "moon", "link_delay", "no_dres=1", "link_cut+3", "link_cut@", "link_cut@1@2"]
)
def test_what_is_no_fault_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="--fault"):
        IsoFault.parse(text)


def test_a_cut_link_stops_it_and_nothing_is_heard_of_it() -> None:
    """The cut lasts 0.5 s, longer than the timeout."""
    centre = driving("link_cut@5+0.5", for_s=4.9)
    centre.run(0.2)
    heard, speed = len(centre.monrs), centre.played.body.speed_mps
    centre.run(0.3)
    assert len(centre.monrs) == heard
    assert centre.played.body.speed_mps < speed
    centre.run(0.3)
    assert centre.monr.state == ControlState.ABORTING


def test_a_cut_that_is_shorter_than_the_timeout_is_borne() -> None:
    centre = driving("link_cut@3+0.1", for_s=4.0)
    assert centre.monr.state == ControlState.RUNNING
    assert len(centre.monrs) < 410


def test_what_is_late_arrives_late_both_ways() -> None:
    centre = driving("link_delay=0.15@1")
    assert centre.monr.x_m is not None
    behind_m = centre.played.body.x_m - centre.monr.x_m
    assert behind_m == pytest.approx(0.15 * 8.0, rel=0.3)
    centre.status = CentreStatus.ABORT
    centre.run(0.1)
    assert not centre.played.brakes_by_itself
    centre.run(0.1)
    assert centre.played.brakes_by_itself


def test_deaf_to_abort_it_says_aborting_and_drives_on() -> None:
    centre = driving("deaf_to_abort")
    since = centre.played.body
    centre.status = CentreStatus.ABORT
    centre.run(1.0)
    assert centre.monr.state == ControlState.ABORTING
    assert way_m(since, centre.played.body) == pytest.approx(8.0, abs=0.5)


def test_deaf_to_abort_it_stops_for_silence() -> None:
    centre = driving("deaf_to_abort")
    centre.status = CentreStatus.ABORT
    centre.run(0.5)
    centre.status = None
    centre.run(5.0)
    assert centre.played.body.speed_mps == 0.0


@pytest.mark.parametrize("what", ["heartbeats", "connection"])
def test_deaf_to_silence_it_drives_to_its_trajectorys_end(what: str) -> None:
    centre = driving("deaf_to_silence")
    centre.status = None
    if what == "connection":
        centre.played.disconnect(centre.now_ns)
    centre.run(2.0)
    assert centre.played.body.speed_mps == pytest.approx(8.0, abs=0.2)
    centre.run(60.0)
    assert (centre.played.body.speed_mps, centre.played.body.x_m) == (
        0.0,
        pytest.approx(200.0, abs=0.5),
    )


def test_an_early_one_ignores_the_start_time() -> None:
    centre = centre_of("early_start").armed(TRAJ)
    assert centre.start(1.0) == 1
    centre.run(0.05)
    assert centre.monr.state == ControlState.RUNNING


def test_one_that_believes_two_centres_obeys_both() -> None:
    centre = driving("two_centres")
    assert centre.played.connect("10.0.0.9", centre.now_ns)
    stranger = Centre(centre.played, "10.0.0.9")
    stranger.now_ns = centre.now_ns
    stranger.beat(CentreStatus.ABORT)
    assert centre.played.brakes_by_itself


def test_one_without_a_discovery_response_answers_the_rest() -> None:
    centre = centre_of("no_dres")
    centre.connect()
    assert centre.send(Dreq()) is None
    assert isinstance(centre.send(Strt(None, None)), Grem)


def test_a_yaw_beyond_a_full_turn_is_unavailable_for_who_reads_it() -> None:
    centre = driving("yaw_range@1")
    assert centre.monrs[0].yaw_rad == 0.0
    assert centre.monr.yaw_rad is None


def test_another_version_is_read_by_nobody() -> None:
    centre = driving("wrong_version@1", for_s=0.9)
    heard = len(centre.monrs)
    centre.run(1.0)
    assert len(centre.monrs) <= heard + 10
    assert "version 3" in centre.refused[0]


def test_pieces_of_a_message_make_the_whole() -> None:
    centre = centre_of("fragments")
    assert centre.played.connect(centre.address[0], centre.now_ns)
    answers: list[Any] = [centre.send(Dreq(), acknowledge=False)]
    while answers[-1] is None:
        centre.now_ns += 10_000_000
        centre.hear()
        answers.append(centre.answers[-1] if centre.answers else None)
    assert isinstance(answers[-1], Dres)
    assert len(answers) > 10
