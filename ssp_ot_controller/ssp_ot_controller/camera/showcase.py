"""Contact sheets of the camera's pictures, to look at: would a person name every object?

``python -m ssp_ot_controller.camera.showcase --out docs/images`` writes ``camera-classes.jpg``
(each class from three sides at 10, 25 and 40 m) and ``camera-conditions.jpg`` (day, dusk, rain and
fog).
"""

from __future__ import annotations

import math
from pathlib import Path

import click
import cv2
import numpy as np

from ssp_core.errors import SspError
from ssp_core.files import make_folder, write_bytes
from ssp_core.motion.state import DEFAULT_SIZES, ObjectState
from ssp_core.run_file.model import Camera, Look
from ssp_core.run_file.road import Lane, Road
from ssp_core.run_file.values import Start
from ssp_core.vocabulary import ObjectClass, Role
from ssp_core.world.camera import shown_box, view_from
from ssp_ot_controller.camera.frames import jpeg
from ssp_ot_controller.camera.kernels.jit import Array
from ssp_ot_controller.camera.renderer.render import render
from ssp_ot_controller.camera.renderer.scene import Indicator, Scene

_SEED = 1
_STAMP_NS = 1_400_000_000  # indicators shine, and the windscreen is wet
DISTANCES_M = (10.0, 25.0, 40.0)
SIDES = {"rear": 0.0, "side": math.pi / 2, "front": math.pi}
_TILE = (124, 96)
_SCENE = (480, 270)
_QUALITY = 88
_STRIP_PX = 14
CONDITIONS = {
    "day": Look(),
    "dusk": Look(light="dusk"),
    "rain": Look(rain=0.7),
    "fog": Look(fog_per_m=0.03),
    "dusk, rain, city": Look(palette="dusk_city", light="dusk", rain=0.5),
}
_ROAD = Road(
    origin=Start(x_m=0.0, y_m=0.0, yaw_rad=0.0),
    length_m=260.0,
    lanes=[
        Lane(y_m=0.0, width_m=3.5, direction="forward"),
        Lane(y_m=3.5, width_m=3.5, direction="forward"),
        Lane(y_m=7.0, width_m=3.5, direction="backward"),
    ],
    sidewalk_left_m=2.0,
    sidewalk_right_m=2.0,
    crossing_x_m=75.0,
)


def _thing(
    object_id: str, object_class: ObjectClass, x_m: float, y_m: float, yaw_rad: float = 0.0,
    speed_mps: float = 5.0, acceleration_mps2: float = 0.0,
) -> ObjectState:  # fmt: skip
    return ObjectState(
        object_id, object_class, Role.TRAFFIC, _STAMP_NS, x_m, y_m, yaw_rad, speed_mps,
        acceleration_mps2, 0.0, DEFAULT_SIZES[object_class],
    )  # fmt: skip


_VUT = _thing("vut", ObjectClass.CAR, 10.0, 0.0, 0.0, 10.0)


def _titled(image: Array, text: str) -> Array:
    """The picture under a strip with black words on white."""
    strip = np.full((_STRIP_PX, image.shape[1], 3), 245, np.uint8)
    place, font = (3, _STRIP_PX - 4), cv2.FONT_HERSHEY_SIMPLEX
    cv2.putText(strip, text, place, font, 0.36, (20, 20, 20), 1, cv2.LINE_AA)
    return np.vstack([strip, image])


def classes(camera: Camera) -> Array:
    """Rows are classes; columns are sides at each distance, from camera to nearest point."""
    known = [one for one in ObjectClass if one is not ObjectClass.UNKNOWN]
    columns = [(distance_m, side) for distance_m in DISTANCES_M for side in SIDES]
    return np.vstack([np.hstack([_tile(one, *at, camera) for at in columns]) for one in known])


def _tile(object_class: ObjectClass, distance_m: float, side: str, camera: Camera) -> Array:
    """A cut-out around an object; its pixels are kept as they are, only larger."""
    size = DEFAULT_SIZES[object_class]
    near_m = {"rear": size.rear_m, "front": size.front_m}.get(side, size.width_m / 2)
    x_m = _VUT.x_m + camera.forward_m + distance_m + near_m
    # From the side, its middle is ahead.
    y_m = (size.rear_m - size.front_m) / 2 if side == "side" else 0.0
    speed_mps = 1.4 if object_class is ObjectClass.PEDESTRIAN else 5.0
    state = _thing(object_class.word, object_class, x_m, y_m, SIDES[side], speed_mps)
    scene = Scene(_ROAD, _VUT, (state,), {state.object_id: 0.35})
    image = render(scene, Look(), camera, 3, _SEED)
    left, top, right, bottom = shown_box(view_from(_VUT.pose, camera), state) or (0, 0, 1, 1)
    wide, high = _TILE
    scale = high / (max(bottom - top, (right - left) * high / wide, 16.0) * 1.35)
    x, y = (wide - scale * (left + right)) / 2, (high - scale * (top + bottom)) / 2
    move = np.array([[scale, 0.0, x], [0.0, scale, y]])
    how = cv2.INTER_NEAREST if scale > 1.0 else cv2.INTER_AREA
    cut = np.asarray(cv2.warpAffine(image, move, _TILE, flags=how, borderValue=(128, 128, 128)))
    return _titled(cut, f"{object_class.word} {distance_m:.0f} m")


def street(look: Look, camera: Camera) -> Array:
    """A street with a bit of everything: who brakes, who indicates, who walks."""
    objects = (
        _thing("a1", ObjectClass.CAR, 27.0, 3.5, 0.0, 8.0, -3.0),
        _thing("truck", ObjectClass.TRUCK, 52.0, 0.0),
        _thing("p", ObjectClass.PEDESTRIAN, 30.0, -2.6, 1.2, 1.4),
        _thing("c", ObjectClass.CYCLIST, 34.0, -1.3),
        _thing("m", ObjectClass.MOTORCYCLE, 40.0, 1.0),
        _thing("on", ObjectClass.CAR, 45.0, 7.0, math.pi),
    )
    scene = Scene(
        _ROAD, _VUT, objects, {o.object_id: 0.3 for o in objects},
        {"a1": Indicator.RIGHT, "truck": Indicator.LEFT},
    )  # fmt: skip
    return render(scene, look, camera, 3, _SEED)


def conditions(camera: Camera) -> Array:
    """One street; each row is a condition."""
    rows = []
    for name, look in CONDITIONS.items():
        small = np.asarray(cv2.resize(street(look, camera), _SCENE, interpolation=cv2.INTER_AREA))
        rows.append(_titled(small, name))
    return np.vstack(rows)


@click.command()
@click.option("--out", required=True, type=click.Path(file_okay=False, path_type=Path))
def showcase(out: Path) -> None:
    """Write contact sheets of the camera's pictures into a folder."""
    camera = Camera()  # 960 x 540
    try:
        make_folder(out)
        for name, image in (
            ("camera-classes.jpg", classes(camera)),
            ("camera-conditions.jpg", conditions(camera)),
        ):
            write_bytes(out / name, jpeg(image, _QUALITY))
            click.echo(out / name)
    except SspError as error:
        raise click.ClickException(str(error)) from error


if __name__ == "__main__":
    showcase(prog_name="python -m ssp_ot_controller.camera.showcase")
