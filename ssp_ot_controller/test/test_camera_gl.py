"""The OpenGL renderer where there is OpenGL, and what it says where there is none."""

from __future__ import annotations

import functools
import importlib.util

import numpy as np
import pytest
from numpy.typing import NDArray

from ssp_core.camera import image_box, view_from
from ssp_core.errors import HostError
from ssp_core.offscreen import check_gl
from ssp_core.run_spec import Camera, CurvePiece, Lane, Look, Road, Start
from ssp_core.state import DEFAULT_SIZES, ObjectState
from ssp_core.vocab import ObjectClass, Role
from ssp_ot_controller.camera.gl.context import GlThread
from ssp_ot_controller.camera.render import render
from ssp_ot_controller.camera.scene import Scene

RASTER = Camera(width_px=320, height_px=180)
GL = RASTER.model_copy(update={"renderer": "gl"})
LOOK = Look(noise_sigma=0.0)
ROAD = Road(
    origin=Start(x_m=0.0, y_m=0.0, yaw_rad=0.0),
    length_m=150.0,
    lanes=[
        Lane(y_m=0.0, width_m=3.5, direction="forward"),
        Lane(y_m=3.5, width_m=3.5, direction="backward"),
    ],
    sidewalk_left_m=2.0,
    sidewalk_right_m=2.0,
    crossing_x_m=45.0,
)
BEND = ROAD.model_copy(
    update={
        "pieces": [CurvePiece(length_m=150.0, start_curvature_1pm=0.01, end_curvature_1pm=0.02)]
    }
)


@functools.lru_cache(maxsize=1)
def has_gl() -> bool:
    try:
        GlThread()
    except HostError:
        return False
    return True


def state(object_class: ObjectClass, x_m: float, y_m: float, object_id: str) -> ObjectState:
    role = Role.VUT if object_id == "vut" else Role.OT
    size = DEFAULT_SIZES[object_class]
    return ObjectState(object_id, object_class, role, 0, x_m, y_m, 0.0, 5.0, 0.0, 0.0, size)


VUT = state(ObjectClass.CAR, 10.0, 0.0, "vut")
CAR = state(ObjectClass.CAR, 26.0, 0.0, "car")


def drawn(
    camera: Camera, *objects: ObjectState, road: Road = ROAD, look: Look = LOOK
) -> NDArray[np.uint8]:
    image: NDArray[np.uint8] = render(Scene(road, VUT, objects), look, camera, 0, 3)
    return image


def drawn_or_refused(
    *objects: ObjectState, road: Road = ROAD, look: Look = LOOK
) -> NDArray[np.uint8] | None:
    """A picture where there is OpenGL; else None, after the message has been looked at."""
    if has_gl():
        return drawn(GL, *objects, road=road, look=look)
    with pytest.raises(HostError, match=r"renderer gl: .*(moderngl|EGL).*pip install 'ssp\[gl\]'"):
        drawn(GL, *objects, road=road, look=look)
    return None


@pytest.mark.parametrize("road", [ROAD, BEND], ids=["straight", "bend"])
@pytest.mark.parametrize("light", ["day", "dusk"])
def test_both_renderers_show_the_same_scene(road: Road, light: str) -> None:
    look = LOOK.model_copy(update={"light": light})
    image = drawn_or_refused(CAR, road=road, look=look)
    if image is not None:
        away = np.abs(image.astype(int) - drawn(RASTER, CAR, road=road, look=look).astype(int))
        assert away.mean() < 5.0
        assert (away.max(axis=2) > 40).mean() < 0.04


def test_the_same_frame_gives_the_same_pixels() -> None:
    image = drawn_or_refused(CAR)
    if image is not None:
        drawn(GL, road=BEND)
        again = drawn_or_refused(CAR)
        assert again is not None
        assert np.array_equal(image, again)


def test_a_body_appears_where_it_projects_and_hides_what_is_behind() -> None:
    truck = state(ObjectClass.TRUCK, 30.0, 0.0, "truck")
    image = drawn_or_refused(truck)
    if image is not None:
        box = image_box(view_from(VUT.pose, GL), truck)
        assert box is not None
        differs = np.abs(image.astype(int) - drawn(GL).astype(int)).max(axis=2) > 12
        left, top, right, bottom = (round(x) for x in box)
        assert differs[top:bottom, left:right].mean() > 0.6
        assert not differs[: top - 2].any()
        behind = state(ObjectClass.PEDESTRIAN, 55.0, 0.0, "walker")
        assert np.array_equal(image, drawn(GL, truck, behind))


def test_bodies_cast_shadows_on_each_other() -> None:
    sun_left = LOOK.model_copy(update={"sun_azimuth_deg": 90.0, "sun_elevation_deg": 30.0})
    alone = drawn_or_refused(CAR, look=sun_left)
    if alone is not None:
        shading = state(ObjectClass.TRUCK, 26.0, 3.5, "truck")
        beside = drawn(GL, CAR, shading, look=sun_left)
        box = image_box(view_from(VUT.pose, GL), CAR)
        assert box is not None
        left, top, right, bottom = (round(x) for x in box)
        part = (slice(top, bottom), slice((left + right) // 2, right))
        assert beside[part].mean() < 0.97 * alone[part].mean()


def test_a_missing_library_is_named_with_its_remedy() -> None:
    with pytest.raises(HostError, match=r"no EGL here.*apt install libegl1"):
        check_gl("libEGL-that-nobody-has.so.9")


def test_a_missing_module_is_named_with_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(HostError, match=r"moderngl isn't installed; pip install 'ssp\[gl\]'"):
        check_gl()


def test_a_context_that_cannot_be_made_leaves_no_thread() -> None:
    def fails() -> None:
        raise HostError("no context")

    with pytest.raises(HostError, match="no context"):
        GlThread(fails)
