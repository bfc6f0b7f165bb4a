"""Places in CARLA's frame, the choice of bodies, and whether a server is accepted."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.carla.acceptance import ServerFacts, opendrive_sha256, refusals
from ssp_core.carla.address import CarlaAddress, parse_address
from ssp_core.carla.blueprints import Blueprint, choose_body, is_candidate
from ssp_core.carla.frame import (
    BodyBox,
    CarlaPose,
    camera_pose,
    feet_pose,
    flat_ground,
    vehicle_pose,
)
from ssp_core.carla.probe import projected_rectangle
from ssp_core.errors import InputError, PeerError
from ssp_core.geometry import Pose2
from ssp_core.motion.state import DEFAULT_SIZES, Size
from ssp_core.run_file.model import Camera
from ssp_core.vocabulary import ObjectClass
from ssp_core.world.camera import project, shown_box, view_from
from tests.support.states import object_state

CAR = DEFAULT_SIZES[ObjectClass.CAR]
BUS_BOX = BodyBox(10.27, 3.94, 4.25, -0.45, 0.12, 2.12)
poses = st.builds(Pose2, st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.floats(-3.1, 3.1))


def in_map(pose: CarlaPose, forward_m: float, right_m: float) -> tuple[float, float]:
    """A point of an actor on level ground, in frame map, by the definition of CARLA's frame."""
    turn = math.radians(pose.yaw_deg)
    x = pose.x_m + math.cos(turn) * forward_m - math.sin(turn) * right_m
    y = pose.y_m + math.sin(turn) * forward_m + math.cos(turn) * right_m
    return x, -y


@given(poses)
def test_the_middle_of_carlas_box_lies_over_the_middle_of_ours(pose: Pose2) -> None:
    size = DEFAULT_SIZES[ObjectClass.BUS]
    placed = vehicle_pose(pose, size, BUS_BOX, flat_ground)
    middle = pose.to_parent(0.5 * (size.front_m - size.rear_m), 0.0)
    assert math.dist(in_map(placed, BUS_BOX.forward_m, BUS_BOX.right_m), middle) < 1e-6
    assert (placed.z_m, placed.pitch_deg, placed.roll_deg) == (0.0, 0.0, 0.0)


def test_a_car_by_hand() -> None:
    # To the north, so to the west in CARLA's y; 1.35 m from the axle to the middle, 0.03 m of it
    # CARLA's own.
    box = BodyBox(4.79, 2.16, 1.49, 0.03)
    placed = vehicle_pose(Pose2(10.0, 20.0, math.pi / 2), CAR, box, flat_ground)
    assert (placed.x_m, placed.y_m) == pytest.approx((10.0, -21.32))
    assert placed.yaw_deg == pytest.approx(-90.0)


def test_on_a_slope_both_ends_of_a_body_are_on_the_ground() -> None:
    def ground(x_m: float, y_m: float) -> float:
        return 3.0 + 0.1 * x_m

    box = BodyBox(4.5, 1.8, 1.5)
    placed = vehicle_pose(Pose2(10.0, 0.0, 0.0), CAR, box, ground)
    assert placed.pitch_deg == pytest.approx(math.degrees(math.atan(0.1)))  # nose up
    assert placed.z_m == pytest.approx(ground(11.35, 0.0))
    back = vehicle_pose(Pose2(10.0, 0.0, math.pi), CAR, box, ground)
    assert back.pitch_deg == pytest.approx(-placed.pitch_deg)
    assert back.z_m == pytest.approx(ground(8.65, 0.0))


def test_a_pedestrian_stands_on_its_feet() -> None:
    placed = feet_pose(Pose2(1.0, 2.0, math.pi / 2), lambda x, y: 0.15)
    assert placed == CarlaPose(1.0, -2.0, 0.15, 0.0, pytest.approx(-90.0), 0.0)


cameras = st.builds(
    Camera,
    width_px=st.just(960),
    height_px=st.just(540),
    pitch_down_rad=st.floats(-0.2, 0.3),
    yaw_left_rad=st.floats(-0.5, 0.5),
    roll_right_rad=st.floats(-0.3, 0.3),
    left_m=st.floats(-0.5, 0.5),
)


@given(poses, cameras, st.floats(8.0, 60.0), st.floats(-4.0, 4.0), st.floats(0.0, 3.0))
def test_carlas_camera_sees_a_point_where_ours_does(
    pose: Pose2, camera: Camera, ahead_m: float, left_m: float, up_m: float
) -> None:
    x, y = pose.to_parent(ahead_m, left_m)
    ours = project(view_from(pose, camera), [(x, y, up_m)])
    placed = camera_pose(pose, CAR, camera, flat_ground)
    depth, right, up = (
        np.array([x, -y, up_m]) - (placed.x_m, placed.y_m, placed.z_m)
    ) @ placed.rotation
    if not ours.in_front[0]:
        return
    u = (camera.width_px - 1) / 2 + camera.focal_px * right / depth
    v = (camera.height_px - 1) / 2 - camera.focal_px * up / depth
    assert (u, v) == pytest.approx((ours.u_px[0], ours.v_px[0]), abs=1e-4)


@pytest.mark.parametrize("slope", [-0.12, 0.0, 0.08])
@pytest.mark.parametrize("object_class", [c for c in DEFAULT_SIZES if c is not ObjectClass.UNKNOWN])
def test_a_box_of_our_size_is_where_our_own_camera_shows_it(
    object_class: ObjectClass, slope: float
) -> None:
    """The box is in the same place of both pictures, wherever CARLA's origin is in the box.

    Body and camera stand on one slope and are tilted alike, so that pictures are those of flat
    ground.
    """

    def ground(x_m: float, y_m: float) -> float:
        return slope * x_m

    size, vut, camera = DEFAULT_SIZES[object_class], Pose2(0.0, 0.0, 0.0), Camera()
    stretch = math.hypot(1.0, slope)  # a metre of road is less on the map
    box = BodyBox(size.length_m, size.width_m, size.height_m, -0.45, 0.12, size.height_m / 2.0)
    at = Pose2(25.0 / stretch, 1.5, 0.0)
    seen = camera_pose(vut, CAR, camera, ground)
    placed = vehicle_pose(at, size, box, ground)
    drawn = projected_rectangle(seen, camera, placed, box)
    shown = shown_box(
        view_from(vut, camera),
        object_state("ot1", x_m=25.0, y_m=1.5, size=size, object_class=object_class),
    )
    assert drawn == pytest.approx(shown, abs=0.5)


BLUEPRINTS = (
    Blueprint("vehicle.tesla.model3", "car", 4),
    Blueprint("vehicle.mercedes.coupe_2020", "car", 4),
    Blueprint("vehicle.carlamotors.firetruck", "truck", 4),
    Blueprint("vehicle.bh.crossbike", "bicycle", 2),
    Blueprint("vehicle.kawasaki.ninja", "motorcycle", 2),
    Blueprint("walker.pedestrian.0001"),
)
BOXES = {
    "vehicle.tesla.model3": BodyBox(4.79, 2.16, 1.49, 0.03),
    "vehicle.mercedes.coupe_2020": BodyBox(4.67, 1.81, 1.44),
    "vehicle.carlamotors.firetruck": BodyBox(8.47, 2.89, 3.83, -0.25),
    "vehicle.bh.crossbike": BodyBox(1.51, 0.0, 1.61),
}


def test_of_a_class_the_nearest_size_is_taken() -> None:
    chosen = choose_body(ObjectClass.CAR, CAR, BLUEPRINTS, BOXES)
    assert chosen.blueprint == "vehicle.mercedes.coupe_2020"
    long_car = Size(3.8, 1.0, 2.2, 1.5)
    assert choose_body(ObjectClass.CAR, long_car, BLUEPRINTS, BOXES).blueprint.endswith("model3")


def test_the_choice_depends_on_no_order() -> None:
    twins = [Blueprint("vehicle.b", "car", 4), Blueprint("vehicle.a", "car", 4)]
    boxes = {one.id: BOXES["vehicle.tesla.model3"] for one in twins}
    for order in (twins, twins[::-1]):
        assert choose_body(ObjectClass.CAR, CAR, order, boxes).blueprint == "vehicle.a"


@pytest.mark.parametrize(
    ("object_class", "words"),
    [
        (ObjectClass.BUS, "no blueprint for a bus"),
        (ObjectClass.CYCLIST, r"crossbike \(its box is empty: 1.51 × 0.00 × 1.61 m\)"),
        (ObjectClass.PEDESTRIAN, r"no body for a pedestrian: .*0001 \(not spawned\)"),
    ],
)
def test_without_a_body_the_server_is_refused(object_class: ObjectClass, words: str) -> None:
    with pytest.raises(PeerError, match=words):
        choose_body(object_class, DEFAULT_SIZES[object_class], BLUEPRINTS, BOXES)


def test_each_blueprint_is_of_one_class_at_most() -> None:
    for blueprint in (*BLUEPRINTS, Blueprint("vehicle.x", "", 4), Blueprint("static.prop.box")):
        found = [c for c in ObjectClass if is_candidate(blueprint, c)]
        assert len(found) == int(blueprint in BLUEPRINTS), blueprint


def test_a_map_is_compared_without_mark_and_line_ends() -> None:
    text = "<OpenDRIVE>\n <header/>\n</OpenDRIVE>\n"
    same = [text, "\ufeff" + text, text.replace("\n", "\r\n"), text.replace("\n", "\r")]
    assert len({opendrive_sha256(one) for one in same}) == 1
    assert opendrive_sha256(text + " ") != opendrive_sha256(text)


FACTS = ServerFacts(
    "0.9.16",
    "0.9.16",
    "Carla/Maps/Town01",
    "sha256:a",
    actors=("spectator", "traffic.traffic_light", "traffic.speed_limit.30"),
)


def test_an_empty_world_of_the_wanted_map_is_accepted() -> None:
    assert refusals(FACTS, "sha256:a") == []
    assert refusals(FACTS, None) == []


def test_each_reason_not_to_run_is_told_with_its_values_and_a_remedy() -> None:
    found = refusals(
        replace(
            FACTS, synchronous=True, actors=("vehicle.a.b", "walker.c", "vehicle.a.b", "spectator")
        ),
        "sha256:b",
    )
    assert [one.text for one in found] == [
        "the server is synchronous and no client ticks it: a client died",
        "3 actors of somebody else are in the world: 2 × vehicle.a.b, 1 × walker.c",
        "the server's map Carla/Maps/Town01 has OpenDRIVE sha256:a, the run's has sha256:b",
    ]
    assert all(one.remedy for one in found)
    (ticked,) = refusals(replace(FACTS, synchronous=True, ticking=True), None)
    assert ticked.text == "another client ticks the server"
    # Of a server of another version nothing else is believed.
    (other,) = refusals(replace(FACTS, version="0.9.15", synchronous=True), "sha256:b")
    assert other.text == "the server is CARLA 0.9.15, the client 0.9.16"


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("carla://gpu7:2000", "gpu7", 2000),
        ("gpu7", "gpu7", 2000),
        ("10.0.0.3:4000", "10.0.0.3", 4000),
        ("carla://[::1]:2010", "::1", 2010),
    ],
)
def test_an_address(text: str, host: str, port: int) -> None:
    found = parse_address(text, "--camera")
    assert found == CarlaAddress(host, port)
    assert parse_address(f"carla://{found}", "--camera") == found


@pytest.mark.parametrize(
    "text",
    [
        *("", "carla://", "a:b", "a:0", "a:65535", "http://a:2000", "a:2000/x", "a b", "::1"),
        *("a..b", "carla://a..b:2000", "a" * 64),
    ],
)
def test_no_address(text: str) -> None:
    with pytest.raises(InputError, match="--camera: is no address"):
        parse_address(text, "--camera")
