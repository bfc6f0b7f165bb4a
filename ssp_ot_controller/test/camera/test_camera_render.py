"""The renderer: repeatable, mirror-symmetric, right about occlusion, place and appearance."""

from __future__ import annotations

import hashlib
import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ssp_core.geometry import Pose2, wrap_angle
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Camera, Look
from ssp_core.run_file.road import Lane, PartialCrossing, Road
from ssp_core.run_file.values import Start
from ssp_core.vocabulary import ObjectClass
from ssp_core.world.camera import shown_box, view_from
from ssp_ot_controller.camera.renderer.render import Scene, render
from ssp_ot_controller.camera.renderer.stage import Detail
from ssp_ot_controller.camera.storyboards import storyboard
from tests.support.states import object_state

Image = NDArray[np.uint8]

CAMERA = Camera(width_px=480, height_px=270)
PLAIN = Detail(scenery=False, texture=False)
QUIET = Look(noise_sigma=0.0, sun_azimuth_deg=180.0)
ROAD = Road(
    origin=Start(x_m=0.0, y_m=0.0, yaw_rad=0.0),
    length_m=200.0,
    lanes=[
        Lane(y_m=0.0, width_m=3.5, direction="forward"),
        Lane(y_m=3.5, width_m=3.5, direction="backward"),
    ],
    sidewalk_left_m=2.0,
    sidewalk_right_m=0.0,
    crossing_x_m=45.0,
)
CLASSES = [c for c in ObjectClass if c is not ObjectClass.UNKNOWN]


def thing(
    object_class: ObjectClass,
    x_m: float,
    y_m: float = 0.0,
    yaw_rad: float = 0.0,
    speed_mps: float = 1.0,
    object_id: str = "thing",
    **changes: float,
) -> ObjectState:
    return object_state(object_id, object_class, x_m, y_m, yaw_rad, speed_mps, **changes)


VUT = thing(ObjectClass.CAR, 10.0, object_id="vut")


def picture(
    *objects: ObjectState,
    look: Look = QUIET,
    vut: ObjectState = VUT,
    road: Road = ROAD,
    frame_index: int = 0,
    seed: int = 3,
    detail: Detail = PLAIN,
    travelled_m: float = 0.0,
) -> Image:
    travelled = dict.fromkeys((o.object_id for o in objects), travelled_m)
    scene = Scene(road, vut, objects, travelled)
    image: Image = render(scene, look, CAMERA, frame_index, seed, detail)
    return image


def change(a: Image, b: Image) -> NDArray[Any]:
    """Largest change of a channel per pixel."""
    return np.asarray(np.abs(a.astype(int) - b.astype(int)).max(axis=2))


def test_same_input_gives_same_pixels() -> None:
    objects = (thing(ObjectClass.CAR, 30.0), thing(ObjectClass.CYCLIST, 25.0, -1.0))
    look = Look(noise_sigma=2.0)
    first = picture(*objects, look=look, detail=Detail())
    picture(thing(ObjectClass.BUS, 20.0), look=look, detail=Detail())  # leaves nothing behind
    assert np.array_equal(first, picture(*objects, look=look, detail=Detail()))


def test_two_processes_draw_the_same_pixels(tmp_path: Path) -> None:
    board = storyboard("cut_in", 3)
    camera = CAMERA.model_dump_json()
    program = f"""
import hashlib
from ssp_core.run_file.model import Camera
from ssp_ot_controller.camera.renderer.render import Scene, render
from ssp_ot_controller.camera.storyboards import storyboard
board = storyboard("cut_in", 3)
scene = Scene(board.road, board.vut.state(4.0), board.states(4.0))
image = render(scene, board.look, Camera.model_validate_json({camera!r}), 7, board.seed)
print(hashlib.sha256(image.tobytes()).hexdigest())
"""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=environment,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=600,
        check=True,
    )
    scene = Scene(board.road, board.vut.state(4.0), board.states(4.0))
    image = render(scene, board.look, CAMERA, 7, board.seed)
    assert done.stdout.strip() == hashlib.sha256(image.tobytes()).hexdigest()


def test_mirrored_scene_gives_mirrored_picture() -> None:
    def mirrored(state: ObjectState) -> ObjectState:
        return replace(state, y_m=-state.y_m, yaw_rad=-state.yaw_rad)

    other_road = ROAD.model_copy(
        update={
            "lanes": [lane.model_copy(update={"y_m": -lane.y_m}) for lane in ROAD.lanes],
            "sidewalk_left_m": ROAD.sidewalk_right_m,
            "sidewalk_right_m": ROAD.sidewalk_left_m,
        }
    )
    objects = (
        thing(ObjectClass.CAR, 28.0, 1.5, -0.2, object_id="a"),
        thing(ObjectClass.TRUCK, 60.0, -1.0, 0.1, object_id="b"),
    )
    look = QUIET.model_copy(update={"sun_azimuth_deg": 70.0})
    other_look = QUIET.model_copy(update={"sun_azimuth_deg": -70.0})
    straight = picture(*objects, look=look)
    turned = picture(*(mirrored(o) for o in objects), look=other_look, road=other_road)
    off = change(straight, turned[:, ::-1])
    assert (off > 3).mean() < 0.002
    assert (change(straight, turned) > 3).mean() > 0.05  # the scene itself isn't symmetric


def test_rigid_motion_of_everything_changes_nothing() -> None:
    origin = Pose2(512.0, -240.0, math.radians(37.0))
    moved_road = ROAD.model_copy(
        update={"origin": Start(x_m=origin.x_m, y_m=origin.y_m, yaw_rad=origin.yaw_rad)}
    )

    def moved(state: ObjectState) -> ObjectState:
        x, y = origin.to_parent(state.x_m, state.y_m)
        return replace(state, x_m=x, y_m=y, yaw_rad=wrap_angle(state.yaw_rad + origin.yaw_rad))

    objects = (thing(ObjectClass.CAR, 28.0, 1.5, 3.0), thing(ObjectClass.PEDESTRIAN, 30.0, -3.0))
    look = QUIET.model_copy(update={"sun_azimuth_deg": QUIET.sun_azimuth_deg + 37.0})
    here = picture(*objects, detail=Detail())
    there = picture(
        *(moved(o) for o in objects), look=look, vut=moved(VUT), road=moved_road, detail=Detail()
    )
    assert (change(here, there) > 3).mean() < 0.002


def test_nearer_body_hides_the_farther_one() -> None:
    truck = thing(ObjectClass.TRUCK, 24.0, object_id="truck")
    hidden = thing(ObjectClass.PEDESTRIAN, 45.0, object_id="walker")
    in_view = replace(hidden, x_m=20.0)
    alone = picture(truck)
    assert np.array_equal(alone, picture(truck, hidden))
    assert np.array_equal(alone, picture(hidden, truck))
    assert (change(alone, picture(truck, in_view)) > 20).sum() > 200


@pytest.mark.parametrize("object_class", CLASSES)
def test_a_body_appears_where_it_projects(object_class: ObjectClass) -> None:
    body = thing(object_class, 42.0, -1.2, 0.3)
    box = shown_box(view_from(VUT.pose, CAMERA), body)
    assert box is not None
    left, top, right, bottom = box
    differs = change(picture(), picture(body)) > 8
    # Nothing above the box or beside its upper part; the ground also takes the shadow.
    middle = (top + bottom) / 2
    rows, columns = np.nonzero(differs)
    assert rows.min() >= math.floor(top) - 1
    upper = columns[rows < middle]
    assert upper.min() >= math.floor(left) - 1
    assert upper.max() <= math.ceil(right) + 1
    inside = differs[round(top) : round(bottom), round(left) : round(right)]
    assert inside.mean() > 0.3


def test_classes_look_different() -> None:
    pictures = [picture(thing(c, 30.0, yaw_rad=0.5)) for c in CLASSES]
    for i, a in enumerate(pictures):
        for b in pictures[i + 1 :]:
            assert (change(a, b) > 15).sum() > 60


def test_seed_is_for_noise_scenery_and_texture_only() -> None:
    car = thing(ObjectClass.CAR, 30.0)
    assert np.array_equal(picture(car, seed=1), picture(car, seed=2))
    assert not np.array_equal(
        picture(car, seed=1, detail=Detail()), picture(car, seed=2, detail=Detail())
    )


def test_noise_differs_per_frame_and_has_the_asked_strength() -> None:
    clean = picture().astype(float)
    look = QUIET.model_copy(update={"noise_sigma": 4.0})
    first, second = picture(look=look), picture(look=look, frame_index=1)
    assert not np.array_equal(first, second)
    middle = (clean > 20) & (clean < 235)
    residue = (first - clean)[middle]
    assert residue.std() == pytest.approx(4.0, abs=0.2)
    assert abs(residue.mean()) < 0.05


def test_brake_lamps_shine_below_the_limit() -> None:
    def bright_red(acceleration_mps2: float) -> int:
        image = picture(thing(ObjectClass.CAR, 24.0, acceleration_mps2=acceleration_mps2))
        blue, green, red = np.moveaxis(image.astype(int), 2, 0)
        return int(((red > 235) & (blue < 130) & (green < 130)).sum())

    assert bright_red(-0.5) == bright_red(0.0)
    assert bright_red(-0.51) > bright_red(0.0) + 20


def test_legs_move_with_the_way_and_rest_when_standing() -> None:
    walking = thing(ObjectClass.PEDESTRIAN, 20.0, yaw_rad=math.pi / 2)
    standing = replace(walking, speed_mps=0.0)
    quarter = 1.45 / 4
    assert (change(picture(walking), picture(walking, travelled_m=quarter)) > 20).sum() > 30
    assert np.array_equal(picture(standing), picture(standing, travelled_m=quarter))
    rider = thing(ObjectClass.CYCLIST, 20.0, yaw_rad=math.pi / 2)
    assert (change(picture(rider), picture(rider, travelled_m=1.3)) > 20).sum() > 30


def test_the_camera_carrier_is_not_drawn() -> None:
    assert np.array_equal(picture(), picture(VUT))


def test_bodies_at_and_behind_the_camera() -> None:
    beside = thing(ObjectClass.TRUCK, 9.0, 3.5)  # reaches from behind the camera to ahead of it
    behind = thing(ObjectClass.BUS, -20.0)
    assert (change(picture(), picture(beside)) > 20).mean() > 0.05
    assert np.array_equal(picture(), picture(behind))


def test_palettes_look_clearly_different() -> None:
    names = ("suburb", "proving_ground", "dusk_city")
    views = [
        picture(look=Look(palette=name), detail=Detail()).reshape(-1, 3).astype(float)
        for name in names
    ]
    for i, a in enumerate(views):
        for b in views[i + 1 :]:
            assert np.abs(a - b).mean() > 20


def test_zebra_crossing_is_painted_where_it_is() -> None:
    without = ROAD.model_copy(update={"crossing_x_m": None})
    near = ROAD.model_copy(update={"crossing_x_m": 24.0})
    rows = np.nonzero(change(picture(road=near), picture(road=without)).max(axis=1) > 30)[0]
    # Stop line 3.6 m before the centre line of the crossing to 3.6 m beyond it, camera at 11.8 m.
    lens = CAMERA.focal_px
    for row, distance in ((rows.max(), 24.0 - 3.6 - 11.8), (rows.min(), 24.0 + 3.6 - 11.8)):
        angle = math.atan2(CAMERA.height_m, distance) - CAMERA.pitch_down_rad
        assert row == pytest.approx(134.5 + lens * math.tan(angle), abs=2.5)


def test_every_zebra_crossing_of_a_road_is_painted() -> None:
    """Each where it is alone, and the rows between them as without any."""
    both = ROAD.model_copy(update={"crossing_x_m": 24.0, "further_crossings_x_m": [60.0]})
    alone = [ROAD.model_copy(update={"crossing_x_m": x}) for x in (None, 24.0, 60.0)]
    without, near, far = (picture(road=road) for road in alone)
    found = picture(road=both)
    split = 145  # a row between both, 20 m ahead
    assert (found[:split] == far[:split]).all()
    assert (found[split:] == near[split:]).all()
    assert (far[:split] != without[:split]).any()
    assert (near[split:] != without[split:]).any()


def test_a_zebra_over_some_lanes_is_painted_on_these() -> None:
    """Right of the middle of the road here: nothing changes to the left of it."""
    middle = (ROAD.left_edge_m + ROAD.right_edge_m) / 2
    zebra = PartialCrossing(x_m=24.0, right_m=ROAD.right_edge_m, left_m=middle)
    without, whole, part = (
        picture(road=ROAD.model_copy(update=update))
        for update in (
            {"crossing_x_m": None},
            {"crossing_x_m": 24.0},
            {"crossing_x_m": None, "partial_crossings": [zebra]},
        )
    )
    changed = (part != without).any(axis=2)
    of_whole = (whole != without).any(axis=2)
    assert changed.any()
    assert np.flatnonzero(changed.any(axis=0)).min() > np.flatnonzero(of_whole.any(axis=0)).min()
    bars = changed & of_whole
    assert 0.2 < bars.sum() / of_whole.sum() < 0.8


def test_fog_hides_what_is_far() -> None:
    far = thing(ObjectClass.BUS, 120.0)
    clear = QUIET.model_copy(update={"fog_per_m": 0.0})
    thick = QUIET.model_copy(update={"fog_per_m": 0.05})
    seen = change(picture(look=clear), picture(far, look=clear)).max()
    hidden = change(picture(look=thick), picture(far, look=thick)).max()
    assert seen > 60 > 10 > hidden
