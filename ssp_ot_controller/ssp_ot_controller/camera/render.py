"""The front camera's picture of a scene, as a pure function.

All work is done in the block's frame (x along the road, y left, z up, road surface at 0), where
coordinates are small and the road is a function of y. Two samples per pixel and axis for bodies;
the ground is averaged analytically.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ssp_core.geometry import Pose2
from ssp_core.run_spec import Camera, Look, Road
from ssp_core.state import DEFAULT_SIZES, ObjectState
from ssp_core.vocab import ObjectClass, Role
from ssp_ot_controller.camera import (
    cars,
    compose,
    ground,
    heavy_vehicles,
    light,
    people,
    sensor,
)
from ssp_ot_controller.camera.buffers import SAMPLES, Buffers
from ssp_ot_controller.camera.contact import contact
from ssp_ot_controller.camera.jit import Array
from ssp_ot_controller.camera.mesh import Mesh
from ssp_ot_controller.camera.model import View, view_from
from ssp_ot_controller.camera.palettes import Palette, rgb
from ssp_ot_controller.camera.raster import rasterise, rasterise_cover
from ssp_ot_controller.camera.stage import FULL, Detail, Stage, ranges, stage_for
from ssp_ot_controller.camera.vehicle_parts import Lights

BRAKE_MPS2 = -0.5  # brake lamps shine below this acceleration
_SCENERY_RANGE_M = 230.0
_SHADOW_RANGE_M = 110.0
_CONTACT_REACH_M = 0.45
_BUS_PAINTS = (rgb("c9432f"), rgb("2f6fae"), rgb("e0b23c"))
_GRAIN = sensor.make_grain()
_BUFFERS = Buffers()


@dataclass(frozen=True)
class Scene:
    """What is there at one instant.

    Args:
        road: the block.
        vut: state of the vehicle that carries the camera; it isn't drawn, but casts a shadow.
        objects: ground truth of all others, frame map; the VUT may be among them.
        travelled_m: distance travelled so far by object id, which moves legs and pedals.
    """

    road: Road
    vut: ObjectState
    objects: tuple[ObjectState, ...]
    travelled_m: Mapping[str, float] = field(default_factory=dict)


def body(state: ObjectState, palette: Palette, travelled_m: float) -> Mesh:
    """The mesh of an object in its own frame; colours follow from its id."""
    number = zlib.crc32(state.object_id.encode())
    lamps = Lights(state.acceleration_mps2 < BRAKE_MPS2, palette.lamps_on)
    paint = palette.paints[number % len(palette.paints)]
    look = people.outfit(number, palette.clothes, palette.trousers)
    match state.object_class:
        case ObjectClass.TRUCK:
            return heavy_vehicles.truck(state.size, paint, lamps)
        case ObjectClass.BUS:
            return heavy_vehicles.bus(state.size, _BUS_PAINTS[number % len(_BUS_PAINTS)], lamps)
        case ObjectClass.MOTORCYCLE:
            return people.motorcycle(state.size, look, lamps.brake, lamps.lamps)
        case ObjectClass.CYCLIST:
            return people.cyclist(state.size, look, travelled_m, lamps.lamps)
        case ObjectClass.PEDESTRIAN:
            return people.pedestrian(state.size, look, travelled_m, state.speed_mps)
        case _:
            return cars.car(state.size, paint, number // 16, lamps)


def _to_block(pose: Pose2, origin: Pose2) -> Pose2:
    x, y = origin.to_local(pose.x_m, pose.y_m)
    return Pose2(x, y, pose.yaw_rad - origin.yaw_rad)


def _visible(places: Array, view: View, range_m: float) -> Array:
    """Indices of props within range that reach into the horizontal field of view, nearest first."""
    forward = view.rotation[2, :2] / np.linalg.norm(view.rotation[2, :2])
    slope = view.intrinsics.width_px / (2 * view.intrinsics.fx_px)
    dx, dy = places[:, 0] - view.position_m[0], places[:, 1] - view.position_m[1]
    radius = places[:, 2]
    ahead = dx * forward[0] + dy * forward[1]
    aside = np.abs(dx * forward[1] - dy * forward[0])
    inside = aside < ahead * slope + radius * math.sqrt(1.0 + slope * slope)
    kept = np.flatnonzero((ahead > -radius) & (ahead < range_m) & inside)
    return np.asarray(kept[np.argsort(ahead[kept], kind="stable")])


def render(
    scene: Scene,
    look: Look,
    camera: Camera,
    frame_index: int,
    seed: int,
    detail: Detail = FULL,
) -> Array:
    """The picture that the VUT's front camera takes.

    The same arguments give the same pixels. The seed places scenery and texture; seed and
    frame_index together draw the sensor noise.

    Args:
        scene: what is there.
        look: palette, fog, sun (azimuth counter-clockwise from the map's x axis), exposure, noise.
        camera: lens and mounting.
        frame_index: number of the frame in its run.
        seed: of the run.
        detail: leaves scenery or texture away.

    Returns:
        Shape (height, width, 3), uint8, blue, green, red.
    """
    stage = stage_for(scene.road, look, seed, detail)
    origin = scene.road.origin.pose
    view = view_from(_to_block(scene.vut.pose, origin), camera)
    bodies: list[light.Lit] = []
    shadows: list[Array] = []
    boxes: list[tuple[float, ...]] = []
    others = [o for o in scene.objects if o.object_id != scene.vut.object_id]
    for state in [*others, scene.vut]:
        pose = _to_block(state.pose, origin)
        floor = ground.ground_height(scene.road, pose.y_m)
        mesh = body(state, stage.palette, scene.travelled_m.get(state.object_id, 0.0))
        placed = light.lit(mesh, stage.palette, stage.sun, pose, floor)
        shadows.append(light.shadow_on_ground(placed.corners, stage.sun, floor))
        if state is scene.vut:
            continue
        bodies.append(placed)
        size = state.size
        inset = 0.12 * size.width_m
        boxes.append(
            (pose.x_m, pose.y_m, math.cos(pose.yaw_rad), math.sin(pose.yaw_rad),
             size.front_m - inset, size.rear_m - inset, size.width_m / 2 - inset)
        )  # fmt: skip
    return _draw(stage, look, view, bodies, shadows, boxes, _noise_state(seed, frame_index))


def warm_up(road: Road, look: Look, camera: Camera, seed: int) -> None:
    """Draws one picture, so that kernels are compiled and scenery is built before time matters."""
    x, y = road.origin.pose.to_parent(0.0, road.lanes[0].y_m)
    states = [
        ObjectState(
            name, ObjectClass.CAR, role, 0, x, y, road.origin.yaw_rad, 0.0, 0.0, 0.0,
            DEFAULT_SIZES[ObjectClass.CAR],
        )
        for name, role in (("carrier", Role.VUT), ("other", Role.TRAFFIC))
    ]  # fmt: skip
    render(Scene(road, states[0], (states[1],)), look, camera, 0, seed)


def _draw(
    stage: Stage,
    look: Look,
    view: View,
    bodies: Sequence[light.Lit],
    shadows: Sequence[Array],
    boxes: Sequence[tuple[float, ...]],
    noise_state: np.uint64,
) -> Array:
    """Runs the kernels for one frame."""
    lens = view.intrinsics
    static = stage.static
    far = _visible(static.places, view, _SCENERY_RANGE_M)
    near = _visible(static.places, view, _SHADOW_RANGE_M)
    room = sum(len(b.kinds) for b in bodies) + int(np.diff(static.body_ranges[far]).sum())
    kept = _BUFFERS.cleared(lens.height_px, lens.width_px, room)
    n = SAMPLES
    # Sample i of a pixel's n lies at (i + 0.5) / n - 0.5 px from its centre.
    samples = np.array(
        [n * lens.fx_px, n * lens.fy_px, n * lens.cx_px + (n - 1) / 2, n * lens.cy_px + (n - 1) / 2]
    )
    columns, rows = view.rotation[0] / lens.fx_px, view.rotation[1] / lens.fy_px
    corner = view.rotation[2] - lens.cx_px * columns - lens.cy_px * rows
    rays = np.stack([corner, columns, rows])
    eye, axes = view.position_m, view.rotation
    flat = np.concatenate(shadows)
    for corners, runs in (
        (flat, ranges([len(flat)])),
        (static.shadows, static.shadow_ranges[near]),
    ):
        rasterise_cover(corners, runs, eye, axes, samples, kept.cover, kept.triangle)
    drawables = [(static.bodies, static.body_ranges[far])]
    if boxes:
        contact(np.array(boxes), eye, rays, _CONTACT_REACH_M, kept.dark)
        moving = light.gather(bodies)
        drawables.insert(0, (moving, ranges([len(moving.kinds)])))
    count = 0
    for lit, runs in drawables:
        count = rasterise(
            lit.corners, lit.attributes, lit.kinds, runs, eye, axes, samples, look.fog_per_m,
            kept.ramp, count, kept.inverse_depth, kept.owner, kept.planes, kept.triangle,
        )  # fmt: skip
    numbers = np.zeros(compose.PARAMETERS)
    numbers[compose.C_FOG : compose.C_FOG + 3] = stage.palette.fog
    numbers[compose.C_SHADOW : compose.C_SHADOW + 3] = stage.palette.shadow
    numbers[compose.C_FOG_PER_M] = look.fog_per_m
    numbers[compose.C_EXPOSURE] = look.exposure
    numbers[compose.C_NOISE] = look.noise_sigma
    out = np.empty((lens.height_px, lens.width_px, 3), np.uint8)
    compose.compose(
        numbers, stage.ground.sums, stage.ground.strips, stage.ground.values,
        stage.ground_numbers, stage.panorama, stage.noise, stage.style, eye, rays, samples,
        kept.inverse_depth, kept.owner, kept.planes, kept.cover, kept.dark, kept.squares,
        _GRAIN, noise_state, kept.row, kept.drawn, kept.hidden, kept.ray,
        kept.single,
        out.reshape(lens.height_px, -1),
    )  # fmt: skip
    return out


def _noise_state(seed: int, frame_index: int) -> np.uint64:
    return np.uint64(np.random.SeedSequence([seed, frame_index]).generate_state(1, np.uint64)[0])
