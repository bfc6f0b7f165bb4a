"""Draws a frame with OpenGL: the same meshes, ground and sky as the raster renderer, with
multisampling and a shadow map."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ssp_core.camera import View
from ssp_core.run_spec import Look
from ssp_ot_controller.camera import ground, light, sky
from ssp_ot_controller.camera.gl import shaders
from ssp_ot_controller.camera.gl.buffers import (
    BODY_LAYOUT,
    BODY_NAMES,
    BODY_NUMBERS,
    SHADOW_TEXELS,
    runs,
    sun_view_of,
    vertices,
)
from ssp_ot_controller.camera.gl.context import GlThread, gl_thread
from ssp_ot_controller.camera.gl.ground_mesh import ground_mesh
from ssp_ot_controller.camera.ground_row import KERB_FACE
from ssp_ot_controller.camera.jit import Array
from ssp_ot_controller.camera.placing import Body
from ssp_ot_controller.camera.raster_frame import (
    CONTACT_REACH_M,
    SCENERY_RANGE_M,
    SHADOW_RANGE_M,
    LightField,
)
from ssp_ot_controller.camera.stage import Stage

_NEAR_M, _FAR_M = 0.1, 1500.0
_MOST_BOXES = 48
_MOST_STAGES = 2  # whose buffers the driver keeps
_NO_CROSSING = 1e9


def light_field(stage: Stage, look: Look, view: View, bodies: Sequence[Body]) -> LightField:
    """The light of a frame; as raster_frame.light_field.

    Raises:
        HostError: there is no OpenGL here.
    """
    thread = gl_thread()
    return thread.call(_painter(thread).paint, stage, view, bodies)


_PAINTERS: dict[int, _Painter] = {}


def _painter(thread: GlThread) -> _Painter:
    key = id(thread)
    if key not in _PAINTERS:
        _PAINTERS[key] = thread.call(_Painter, thread.context)
    return _PAINTERS[key]


@dataclass
class _Kept:
    """What the driver keeps of a stage."""

    stage: Stage
    scenery: Any
    scenery_shadow: Any
    ground: Any
    textures: dict[str, Any]
    buffers: tuple[Any, ...]

    def release(self) -> None:
        """Gives the driver's memory back."""
        for part in (
            self.scenery, self.scenery_shadow, self.ground, *self.textures.values(), *self.buffers
        ):  # fmt: skip
            part.release()


class _Painter:
    """Programs and buffers of one context; used in its thread only."""

    def __init__(self, context: Any) -> None:
        import moderngl

        self._gl, self._ctx = moderngl, context
        self._ctx.front_face = "cw"  # pictures are drawn upside down
        program = self._ctx.program
        self._body = program(shaders.BODY_VERTEX, shaders.BODY_FRAGMENT)
        self._ground = program(shaders.GROUND_VERTEX, shaders.GROUND_FRAGMENT)
        self._sky = program(shaders.SKY_VERTEX, shaders.SKY_FRAGMENT)
        self._shadow = program(shaders.SHADOW_VERTEX, shaders.SHADOW_FRAGMENT)
        corners = np.array([-1, -1, 1, -1, -1, 1, 1, 1], np.float32)
        buffer = self._ctx.buffer(corners.tobytes())
        self._sky_quad = self._ctx.vertex_array(self._sky, [(buffer, "2f", "corner")])
        self._depth = self._ctx.depth_texture((SHADOW_TEXELS, SHADOW_TEXELS))
        self._depth.compare_func = "<="
        self._depth.filter = (moderngl.LINEAR, moderngl.LINEAR)
        self._shadow_target = self._ctx.framebuffer(depth_attachment=self._depth)
        self._target: tuple[tuple[int, int], Any, Any] | None = None
        self._kept: list[_Kept] = []

    def paint(self, stage: Stage, view: View, bodies: Sequence[Body]) -> LightField:
        kept = self._of_stage(stage)
        moving = self._moving(stage, bodies)
        sun_view = sun_view_of(stage.sun, view)
        self._cast(stage, view, kept, moving, sun_view)
        size = (view.intrinsics.width_px, view.intrinsics.height_px)
        several, single = self._targets(size)
        several.use()
        several.clear(0.0, 0.0, 0.0, 0.0)
        self._set(stage, view, kept, bodies, sun_view)
        self._ctx.disable(self._gl.DEPTH_TEST | self._gl.CULL_FACE)
        self._sky_quad.render(self._gl.TRIANGLE_STRIP)
        self._ctx.enable(self._gl.DEPTH_TEST)
        kept.ground.render()
        self._ctx.enable(self._gl.CULL_FACE)
        for first, count in runs(stage, view, SCENERY_RANGE_M):
            kept.scenery.render(first=first, vertices=count)
        drawn = sum(3 * len(b.mesh) for b in bodies if b.drawn)
        if drawn:
            moving[0].render(vertices=drawn)
        self._ctx.copy_framebuffer(single, several)
        numbers = np.frombuffer(single.read(components=4, dtype="f2"), np.float16)
        for part in moving:
            part.release()
        field = numbers.reshape(size[1], size[0], 4).astype(np.float32)
        return LightField(
            np.ascontiguousarray(field[..., :3] * np.float32(255.0)),
            np.ascontiguousarray(np.abs(field[..., 3])),
            field[..., 3] < 0.0,
            view,
        )

    def _targets(self, size: tuple[int, int]) -> tuple[Any, Any]:
        """Framebuffers with several samples per pixel, and with one."""
        if self._target is None or self._target[0] != size:
            ctx, samples = self._ctx, min(4, self._ctx.max_samples)
            several = ctx.framebuffer(
                [ctx.renderbuffer(size, 4, samples=samples, dtype="f2")],
                ctx.depth_renderbuffer(size, samples=samples),
            )
            single = ctx.framebuffer([ctx.renderbuffer(size, 4, dtype="f2")])
            self._target = (size, several, single)
        return self._target[1], self._target[2]

    def _moving(self, stage: Stage, bodies: Sequence[Body]) -> tuple[Any, Any, Any]:
        """Vertex arrays for picture and shadow of what moves, and their buffer.

        Drawn bodies come first.
        """
        dark = replace(stage.palette, sun_light=(0.0, 0.0, 0.0))
        parts = [
            vertices(b.mesh, b.lit, light.lit(b.mesh, dark, stage.sun, b.pose, b.floor_m))
            for b in sorted(bodies, key=lambda b: not b.drawn)
        ]
        buffer = self._ctx.buffer(np.concatenate(parts).tobytes())
        return (*self._arrays(buffer), buffer)

    def _arrays(self, buffer: Any) -> tuple[Any, Any]:
        ctx = self._ctx
        return (
            ctx.vertex_array(self._body, [(buffer, BODY_LAYOUT, *BODY_NAMES)]),
            ctx.vertex_array(self._shadow, [(buffer, "3f 36x", "place")]),
        )

    def _of_stage(self, stage: Stage) -> _Kept:
        for kept in self._kept:
            if kept.stage is stage:
                return kept
        dark = replace(stage.palette, sun_light=(0.0, 0.0, 0.0))
        shade = light.lit(stage.static.mesh, dark, stage.sun)
        corners = vertices(stage.static.mesh, stage.static.bodies, shade)
        if len(corners) == 0:
            corners = np.zeros((3, BODY_NUMBERS), np.float32)
        bodies = self._ctx.buffer(corners.tobytes())
        scenery, shadow = self._arrays(bodies)
        floor = self._ctx.buffer(ground_mesh(stage.road).tobytes())
        layout = [(floor, "3f 2f 1f", "place", "along", "face")]
        kept = _Kept(
            stage, scenery, shadow, self._ctx.vertex_array(self._ground, layout),
            self._textures(stage), (bodies, floor),
        )  # fmt: skip
        for old in self._kept[_MOST_STAGES - 1 :]:
            old.release()
        self._kept = [kept, *self._kept[: _MOST_STAGES - 1]]
        return kept

    def _textures(self, stage: Stage) -> dict[str, Any]:
        gl, ctx = self._gl, self._ctx
        sums = stage.ground.sums.astype(np.float32)  # (2, cells + 1, 6)
        shape = (sums.shape[1], 2)
        made = {
            "sums_a": ctx.texture(shape, 3, np.ascontiguousarray(sums[..., :3]), dtype="f4"),
            "sums_b": ctx.texture(shape, 3, np.ascontiguousarray(sums[..., 3:]), dtype="f4"),
            "noise": ctx.texture(stage.noise.shape[::-1], 1, stage.noise.tobytes(), dtype="f4"),
        }
        levels = sky.colours(stage.panorama)
        made["panorama"] = ctx.texture(levels.shape[1::-1], 3, levels.tobytes(), dtype="f1")
        for name in ("sums_a", "sums_b"):
            made[name].filter = (gl.NEAREST, gl.NEAREST)
        made["noise"].build_mipmaps()
        made["noise"].filter = (gl.LINEAR_MIPMAP_LINEAR, gl.LINEAR)
        made["panorama"].repeat_y = False
        made["panorama"].filter = (gl.LINEAR, gl.LINEAR)
        return made

    def _cast(
        self, stage: Stage, view: View, kept: _Kept, moving: Sequence[Any], sun_view: Array
    ) -> None:
        """Draws the shadow map."""
        self._shadow_target.use()
        self._shadow_target.clear(depth=1.0)
        self._ctx.enable_only(self._gl.DEPTH_TEST)
        self._shadow["sun_view"].write(sun_view.T.astype(np.float32).tobytes())
        for first, count in runs(stage, view, SHADOW_RANGE_M, casting=True):
            kept.scenery_shadow.render(first=first, vertices=count)
        moving[1].render()

    def _set(
        self, stage: Stage, view: View, kept: _Kept, bodies: Sequence[Body], sun_view: Array
    ) -> None:
        """Uniforms of a frame."""
        lens, palette = view.intrinsics, stage.palette
        rows = view.rotation
        wide, high = lens.width_px / (2 * lens.fx_px), lens.height_px / (2 * lens.fy_px)
        outlines = [b.outline for b in bodies if b.drawn][:_MOST_BOXES]
        table = np.zeros((_MOST_BOXES, 7), np.float32)
        if outlines:
            table[: len(outlines)] = outlines
        crossing = stage.ground_numbers[ground.P_CROSSING_X]
        values = {
            "eye": view.position_m,
            "axes": rows.T,
            "lens": (1.0 / wide, 1.0 / high),
            "span": (_NEAR_M, _FAR_M),
            "fog": np.array(palette.fog) / 255.0,
            "fog_per_m": (stage.fog_per_m,),
            "sun_view": sun_view.T,
            "glass": np.array(palette.window_glass) / 255.0,
            "window_lit": np.array(palette.window_lit) / 255.0,
            "lit_share": (palette.window_lit_share,),
            "cells_per_m": (1.0 / ground.CELL_M,),
            "half_width": (ground.HALF_WIDTH_M,),
            "cell_m": (ground.CELL_M,),
            "crossing": (_NO_CROSSING if math.isnan(crossing) else crossing,),
            "textured": (stage.ground_numbers[ground.P_TEXTURE],),
            "marking": palette.marking,
            "kerb_face": np.array(palette.kerb) * KERB_FACE,
            "in_shadow": palette.shadow,
            "dashes": (ground.DASH_M, ground.DASH_PERIOD_M, ground.JOINT_M, ground.JOINT_PERIOD_M),
            "zebra": (ground.ZEBRA_HALF_LENGTH_M, ground.STOP_DISTANCE_M, ground.STOP_WIDTH_M),
            "box_place": table[:, :4],
            "box_size": table[:, 4:],
            "reach": (CONTACT_REACH_M,),
            "rays": np.stack([rows[2], wide * rows[0], high * rows[1]]),
            "far_ground": np.array(palette.verge) / 255.0,
            "eye_height": (view.position_m[2],),
        }
        units = {"shadow_map": self._depth, **kept.textures}
        for program in (self._body, self._ground, self._sky):
            for name in program:
                if name in values:
                    data = np.ascontiguousarray(values[name], dtype=np.float32)
                    program[name].write(data.tobytes())
                elif name == "boxes":
                    program[name].value = len(outlines)
                elif name in units:
                    program[name].value = list(units).index(name)
        for unit, texture in enumerate(units.values()):
            texture.use(unit)
