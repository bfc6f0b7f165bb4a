"""Draws the frames of a recorded session again, from the states that it recorded.

The states go in step by step, as they came to the camera, since limbs and indicators depend on
what was before. What is given the same gives the same bytes (docs/camera.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.world.camera import View, view_from
from ssp_ot_controller.camera.frames import Odometer, jpeg, steps_per_frame
from ssp_ot_controller.camera.kernels.jit import Array
from ssp_ot_controller.camera.painter import Painter
from ssp_ot_controller.camera.renderer.bodies import Body, bodies_of, to_block
from ssp_ot_controller.camera.renderer.render import render
from ssp_ot_controller.camera.renderer.scene import Indicators, Scene
from ssp_ot_controller.camera.renderer.stage import shadow_on_ground, stage_for

_NEAR_M = 0.05
# A pixel's samples lie up to half of one from its middle, and edges are softened over one.
_BESIDE_PX = 2


@dataclass(frozen=True)
class Picture:
    """One frame.

    Args:
        pixels: shape (height, width, 3), uint8, blue, green, red, before JPEG.
        jpeg: as the camera records it.
    """

    scene: Scene
    pixels: Array
    jpeg: bytes


class Redrawing:
    """The camera of a recorded run, taking states and drawing those steps that have a frame.

    Args:
        run: with a camera.
    """

    def __init__(self, run: RunSpec) -> None:
        if run.camera is None:
            raise ValueError("the run has no camera")
        self._run, self._camera = run, run.camera
        self._every = steps_per_frame(run.camera.rate_hz, run.step_s)
        self._odometer, self._indicators = Odometer(), Indicators(run.road)

    def see(
        self,
        step: int,
        stamp_ns: int,
        states: Sequence[ObjectState],
        camera_at: ObjectState | None = None,
    ) -> Scene | None:
        """Take the states of the next step; return the scene if the step has a frame.

        Args:
            step: number of the step.
            stamp_ns: session time of the step.
            states: of all objects at that time.
            camera_at: where the VUT carries the camera; None: where it is.
        """
        finite_states = tuple(state for state in states if state.is_finite)
        self._odometer.update(finite_states)
        vut = next((state for state in finite_states if state.object_id == self._run.vut.id), None)
        if step % self._every or vut is None:
            return None
        return Scene(
            self._run.road,
            vut if camera_at is None else camera_at,
            finite_states,
            self._odometer.snapshot(),
            self._indicators.update(finite_states, stamp_ns),
        )

    def draw(
        self, scene: Scene, step: int, stamp_ns: int = 0, painter: Painter | None = None
    ) -> Picture:
        """Return the frame of a scene.

        Args:
            scene: of the step.
            step: number of the step.
            stamp_ns: session time of the step, for another renderer.
            painter: another renderer; None: our own.
        """
        run, index = self._run, step // self._every
        if painter is None:
            pixels = render(scene, run.look, self._camera, index, run.seed)
        else:
            pixels = painter.draw(scene, stamp_ns, index)
        return Picture(scene, pixels, jpeg(pixels, self._camera.jpeg_quality))

    def touched(self, scene: Scene, object_id: str) -> Array:
        """Return the pixels that an object's image or shadow may reach.

        Shape (height, width), bool.

        It is drawn from the object's triangles alone, without the renderer's rasteriser and
        whatever stands in front of it. Light that it sends out or mirrors isn't in it.
        """
        camera, road = self._camera, self._run.road
        shape = (camera.height_px, camera.width_px)
        mask = np.zeros(shape, np.uint8)
        stage = stage_for(road, self._run.look, self._run.seed)
        view = view_from(to_block(scene.vut.pose, road.origin.pose), camera)
        body = _body(scene, object_id, bodies_of(scene, stage))
        if body is not None:
            corners = body.mesh.corners
            _fill(mask, view, corners)
            _fill(mask, view, shadow_on_ground(corners, stage.sun))
        kernel = np.ones((2 * _BESIDE_PX + 1,) * 2, np.uint8)
        return np.asarray(cv2.dilate(mask, kernel) > 0)

    @property
    def reaches_no_further(self) -> bool:
        """Tell whether an object changes no other pixels than ``touched`` has.

        At dusk its lamps light up what is round it, wet ground mirrors it, and motion blur spreads
        it.
        """
        look = self._run.look
        return look.light == "day" and look.rain == 0.0 and self._camera.exposure_time_s == 0.0


def _body(scene: Scene, object_id: str, bodies: Sequence[Body]) -> Body | None:
    """Return the body of an object; bodies come in the order of the scene's others."""
    for state, body in zip(scene.others, bodies, strict=False):
        if state.object_id == object_id:
            return body
    return None


def _fill(mask: Array, view: View, triangles: Array) -> None:
    """Fill what triangles cover, each cut off where the camera can't see.

    Args:
        mask: shape (height, width), uint8; pixels that are covered become 1.
        view: of the camera.
        triangles: shape (n, 3, 3), in the block's frame.
    """
    at = (np.asarray(triangles, np.float64) - view.position_m) @ view.rotation.T
    planes = _planes(view)
    # Shape (n, 3 corners, 5 planes): where it isn't negative, the corner is on the right side.
    sides = at @ planes[:, :3].T + planes[:, 3]
    is_visible = (sides.max(axis=1) >= 0.0).all(axis=1)
    whole = sides.min(axis=(1, 2)) >= 0.0
    for outline in _outline(view, at[whole]):
        cv2.fillConvexPoly(mask, outline, 1)
    for points in at[is_visible & ~whole]:
        for plane in planes:
            points = _cut(points, points @ plane[:3] + plane[3])
        if len(points):
            cv2.fillConvexPoly(mask, _outline(view, points), 1)


def _planes(view: View) -> Array:
    """Compute the planes that bound a picture and as much again on each side.

    They are in the camera's frame.

    Shape (5, 4): a point (x, y, z) is inside where its product with each row's first three numbers
    plus the fourth isn't negative. Farther out OpenCV's coordinates would not suffice.
    """
    lens = view.intrinsics
    right, down = 2.0 * lens.width_px, 2.0 * lens.height_px
    return np.array(
        [
            [0.0, 0.0, 1.0, -_NEAR_M],
            [lens.fx_px, 0.0, lens.cx_px + lens.width_px, 0.0],
            [-lens.fx_px, 0.0, right - lens.cx_px, 0.0],
            [0.0, lens.fy_px, lens.cy_px + lens.height_px, 0.0],
            [0.0, -lens.fy_px, down - lens.cy_px, 0.0],
        ]
    )


def _outline(view: View, points: Array) -> Array:
    """Return the pixels of points in the camera's frame, rounded, shape (..., 2)."""
    lens = view.intrinsics
    u = lens.fx_px * points[..., 0] / points[..., 2] + lens.cx_px
    v = lens.fy_px * points[..., 1] / points[..., 2] + lens.cy_px
    return np.round(np.stack([u, v], axis=-1)).astype(np.int32)


def _cut(points: Array, side: Array) -> Array:
    """Return the part of a convex polygon on the right side of a plane, shape (m, 3), m may be 0.

    Args:
        points: corners of the polygon, shape (n, 3).
        side: of each corner, how far it is on the right side.
    """
    corners = []
    for k in range(len(points)):
        following = (k + 1) % len(points)
        if side[k] >= 0.0:
            corners.append(points[k])
        if (side[k] >= 0.0) != (side[following] >= 0.0):
            share = side[k] / (side[k] - side[following])
            corners.append(points[k] + share * (points[following] - points[k]))
    return np.array(corners).reshape(-1, 3)
