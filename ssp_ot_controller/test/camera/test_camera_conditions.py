"""Conditions between scene and sensor: roll, motion blur, rain, dusk; and lamps that signal."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Camera, Look
from ssp_core.run_file.road import Lane, Road
from ssp_core.run_file.values import Start
from ssp_core.vocabulary import ObjectClass
from ssp_core.world.camera import project, shown_box, view_from
from ssp_ot_controller.camera.kernels.palettes import PALETTES, fog_per_m, palette_of
from ssp_ot_controller.camera.renderer import frame
from ssp_ot_controller.camera.renderer.bodies import bodies_of
from ssp_ot_controller.camera.renderer.render import exposed, render, subframes
from ssp_ot_controller.camera.renderer.scene import Indicator, Scene
from ssp_ot_controller.camera.renderer.stage import FULL, Detail, stage_for
from tests.support.states import object_state

Image = NDArray[np.uint8]

CAMERA = Camera(width_px=320, height_px=180)
PLAIN = Detail(scenery=False, texture=False)
QUIET = Look(noise_sigma=0.0, sun_azimuth_deg=180.0, fog_per_m=0.0)
ROAD = Road(
    origin=Start(x_m=0.0, y_m=0.0, yaw_rad=0.0),
    length_m=200.0,
    lanes=[
        Lane(y_m=0.0, width_m=3.5, direction="forward"),
        Lane(y_m=3.5, width_m=3.5, direction="backward"),
    ],
    sidewalk_left_m=2.0,
    sidewalk_right_m=2.0,
)


def thing(
    object_class: ObjectClass,
    x_m: float,
    y_m: float = 0.0,
    yaw_rad: float = 0.0,
    speed_mps: float = 0.0,
    object_id: str = "thing",
    **changes: float,
) -> ObjectState:
    return object_state(object_id, object_class, x_m, y_m, yaw_rad, speed_mps, **changes)


VUT = thing(ObjectClass.CAR, 10.0, object_id="vut")


def picture(
    *objects: ObjectState,
    camera: Camera = CAMERA,
    look: Look = QUIET,
    vut: ObjectState = VUT,
    frame_index: int = 0,
    detail: Detail = PLAIN,
    **more: Any,
) -> Image:
    image: Image = render(Scene(ROAD, vut, objects, **more), look, camera, frame_index, 3, detail)
    return image


def change(a: Image, b: Image) -> NDArray[Any]:
    return np.asarray(np.abs(a.astype(int) - b.astype(int)).max(axis=2))


def test_light_developed_later_is_the_picture_drawn_at_once() -> None:
    scene = Scene(ROAD, VUT, (thing(ObjectClass.CYCLIST, 22.0, -1.0), thing(ObjectClass.BUS, 60.0)))
    look = Look(noise_sigma=2.0)
    at_once = render(scene, look, CAMERA, 4, 3)
    stage = stage_for(ROAD, look, 3)
    field = frame.light_field(stage, look, view_from(VUT.pose, CAMERA), bodies_of(scene, stage))
    state = np.random.SeedSequence([3, 4]).generate_state(1, np.uint64)[0]
    assert np.array_equal(frame.develop(field.light, look, np.uint64(state)), at_once)


@pytest.mark.parametrize(
    "mounting",
    [
        {"yaw_left_rad": 0.2},
        {"left_m": 0.5, "pitch_down_rad": 0.1},
        {"roll_right_rad": 0.15},
        {"roll_right_rad": -0.4, "yaw_left_rad": -0.15, "left_m": -0.4},
    ],
)
def test_a_body_appears_where_a_turned_camera_sees_it(mounting: dict[str, float]) -> None:
    camera = CAMERA.model_copy(update=mounting)
    body = thing(ObjectClass.CAR, 26.0, 0.5, 0.3)
    box = shown_box(view_from(VUT.pose, camera), body)
    assert box is not None
    left, top, right, bottom = box
    differs = change(picture(camera=camera), picture(body, camera=camera)) > 12
    rows, columns = np.nonzero(differs)
    assert rows.min() >= math.floor(top) - 2
    assert columns.min() >= math.floor(left) - 2 - 0.3 * (bottom - top)  # its shadow leans too
    inside = differs[max(0, round(top)) : round(bottom), max(0, round(left)) : round(right)]
    assert inside.mean() > 0.3


def test_roll_is_the_level_picture_turned() -> None:
    marks = thing(ObjectClass.TRUCK, 30.0)
    leaning = CAMERA.model_copy(update={"roll_right_rad": math.pi / 2})
    tall = CAMERA.model_copy(
        update={
            "width_px": CAMERA.height_px,
            "height_px": CAMERA.width_px,
            "hfov_deg": math.degrees(2 * math.atan(CAMERA.height_px / 2 / CAMERA.focal_px)),
        }
    )
    turned = np.rot90(picture(marks, camera=tall), 1)  # a camera on its right side: a quarter left
    away = np.abs(turned.astype(int) - picture(marks, camera=leaning).astype(int))
    assert away.mean() < 1.0


def test_nothing_moves_nothing_blurs() -> None:
    slow = CAMERA.model_copy(update={"exposure_time_s": 0.02})
    still = thing(ObjectClass.CAR, 25.0)
    assert subframes(Scene(ROAD, VUT, (still,)), slow) == 1
    assert np.array_equal(picture(still), picture(still, camera=slow))


def test_motion_blur_smears_back_to_where_it_was() -> None:
    slow = CAMERA.model_copy(update={"exposure_time_s": 0.1})
    # From right to left at 10 m/s: at the stamp its nose is farthest to the left.
    body = thing(ObjectClass.CAR, 25.0, 0.0, math.pi / 2, 10.0)
    scene = Scene(ROAD, VUT, (body,))
    assert 2 <= subframes(scene, slow) <= 16
    empty, sharp, smeared = picture(), picture(body), picture(body, camera=slow)
    upper = slice(0, 100)  # above the shadow
    sharp_columns = np.nonzero((change(empty, sharp) > 8)[upper].any(axis=0))[0]
    smeared_columns = np.nonzero((change(empty, smeared) > 8)[upper].any(axis=0))[0]
    view = view_from(VUT.pose, CAMERA)
    ends = project(view, [(25.0, 0.0, 0.7), (25.0, -1.0, 0.7)]).u_px
    assert smeared_columns.min() == pytest.approx(sharp_columns.min(), abs=3)
    grown = smeared_columns.max() - sharp_columns.max()
    assert grown == pytest.approx(ends[1] - ends[0], rel=0.25)


def test_own_motion_blurs_the_ground_by_the_speed() -> None:
    camera = CAMERA.model_copy(update={"exposure_time_s": 0.03})
    fast, slow = replace(VUT, speed_mps=15.0), replace(VUT, speed_mps=2.0)
    assert subframes(Scene(ROAD, fast, ()), camera) > subframes(Scene(ROAD, slow, ()), camera) > 1

    def grain(camera: Camera) -> float:
        near = picture(vut=fast, camera=camera, detail=FULL)[150:, 120:200].astype(int)
        return float(np.abs(np.diff(near, axis=0)).mean())

    assert grain(camera) < 0.8 * grain(CAMERA)


def test_day_without_rain_is_the_palette_itself() -> None:
    for name, palette in PALETTES.items():
        assert palette_of(Look(palette=name)) is palette
    assert fog_per_m(Look(fog_per_m=0.004)) == 0.004


def test_rain_falls_anew_in_each_frame_and_the_same_each_time() -> None:
    look = QUIET.model_copy(update={"rain": 0.8})
    car = thing(ObjectClass.CAR, 25.0)
    first = picture(car, look=look, detail=FULL)
    assert np.array_equal(first, picture(car, look=look, detail=FULL))
    assert (change(first, picture(car, look=look, frame_index=1, detail=FULL)) > 8).mean() > 0.005


def test_rain_darkens_the_road_and_takes_contrast() -> None:
    wet = QUIET.model_copy(update={"rain": 1.0})
    road = (slice(150, 178), slice(130, 190))
    assert picture(look=wet)[road].mean() < 0.85 * picture()[road].mean()
    far = thing(ObjectClass.TRUCK, 90.0)
    seen = change(picture(), picture(far)).max()
    assert change(picture(look=wet), picture(far, look=wet)).max() < 0.75 * seen


def test_wet_roads_mirror_what_stands_on_them() -> None:
    wet = QUIET.model_copy(update={"rain": 1.0})
    truck = thing(ObjectClass.TRUCK, 22.0)
    box = shown_box(view_from(VUT.pose, CAMERA), truck)
    assert box is not None
    below = (slice(round(box[3]) + 2, round(box[3]) + 12), slice(150, 170))
    dry = change(picture(), picture(truck))[below].mean()
    assert change(picture(look=wet), picture(truck, look=wet))[below].mean() > dry + 5.0


def test_dusk_is_dark_but_for_lamps() -> None:
    dusk = QUIET.model_copy(update={"light": "dusk"})
    day, evening = picture(detail=FULL), picture(look=dusk, detail=FULL)
    assert evening[:60].mean() < 0.5 * day[:60].mean()
    # The VUT's own lamps light up the road before it, not what lies to the side.
    lit = evening[120:150, 140:180].mean() / day[120:150, 140:180].mean()
    aside = evening[170:178, 0:20].mean() / day[170:178, 0:20].mean()
    assert lit > 1.25 * aside


def bright(image: Image, kind: str) -> NDArray[np.bool_]:
    blue, green, red = np.moveaxis(image.astype(int), 2, 0)
    if kind == "red":
        return np.asarray((red > 200) & (green < 120) & (blue < 120))
    return np.asarray((red > 200) & (green > 110) & (green < 215) & (blue < 110))


def test_brake_lamps_shine_at_dusk() -> None:
    look = QUIET.model_copy(update={"light": "dusk"})
    rolling = picture(thing(ObjectClass.CAR, 20.0), look=look)
    braking = picture(thing(ObjectClass.CAR, 20.0, acceleration_mps2=-3.0), look=look)
    assert bright(braking, "red").sum() > bright(rolling, "red").sum() + 8


@pytest.mark.parametrize(
    "object_class",
    [ObjectClass.CAR, ObjectClass.TRUCK, ObjectClass.BUS, ObjectClass.MOTORCYCLE],
)
@pytest.mark.parametrize("yaw_rad", [0.0, math.pi])
def test_indicators_blink_on_their_side(object_class: ObjectClass, yaw_rad: float) -> None:
    near = thing(object_class, 18.0 if yaw_rad == 0.0 else 26.0, 0.0, yaw_rad)
    unlit = replace(near, stamp_ns=400_000_000)

    def picture_with(state: ObjectState, side: Indicator) -> Image:
        return picture(state, indicators={"thing": side})

    dark = picture_with(unlit, Indicator.LEFT)
    assert np.array_equal(dark, picture(unlit))
    for side, sign in ((Indicator.LEFT, 1.0), (Indicator.RIGHT, -1.0)):
        new = bright(picture_with(near, side), "amber") & ~bright(dark, "amber")
        columns = np.nonzero(new)[1]
        assert len(columns) >= 2
        assert np.all((columns - 159.5) * sign * math.cos(yaw_rad) < 0.0)


def test_the_exposure_of_a_frame_gives_light_in_its_shape() -> None:
    look = Look(rain=0.3, light="dusk")
    camera = CAMERA.model_copy(update={"exposure_time_s": 0.01, "roll_right_rad": 0.05})
    scene = Scene(ROAD, replace(VUT, speed_mps=10.0), (thing(ObjectClass.CAR, 25.0),))
    light = exposed(scene, look, camera, 0, 3, PLAIN)
    assert light.shape == (180, 320, 3)
    assert np.isfinite(light).all()
    assert light.min() >= 0.0
