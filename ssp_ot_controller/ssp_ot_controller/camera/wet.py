"""Wet ground: a road in the rain mirrors what stands beyond it, the more the flatter one looks."""

from __future__ import annotations

import math

from ssp_core.run_file.road import Road
from ssp_ot_controller.camera.bend import locate
from ssp_ot_controller.camera.jit import Array, compiled
from ssp_ot_controller.camera.raster_frame import LightField
from ssp_ot_controller.camera.stage import Stage
from ssp_ot_controller.camera.surfaces import noise_at

_STRENGTH = 0.55  # of a mirror, of water that lies in a rough surface


@compiled
def _reflect(
    source: Array,
    inverse_depth: Array,
    eye: Array,
    rays: Array,
    nodes: Array,
    cells: Array,
    line: Array,
    noise: Array,
    left_m: float,
    right_m: float,
    strength: float,
    light: Array,
) -> None:
    """Mixes the mirror image into the ground's light, column by column.

    What stands on the ground is mirrored about the row where it stands; where nothing stands, the
    sky is about the horizon.
    """
    height, width, _ = light.shape
    for u in range(width):
        foot = -1
        horizon = -1
        for v in range(height):
            if inverse_depth[v, u] > 0.0:
                foot = v
                continue
            dz = rays[0, 2] + u * rays[1, 2] + v * rays[2, 2]
            if dz >= -1e-3:
                horizon = v
                continue
            dx = rays[0, 0] + u * rays[1, 0] + v * rays[2, 0]
            dy = rays[0, 1] + u * rays[1, 1] + v * rays[2, 1]
            depth = -eye[2] / dz
            x, y = eye[0] + depth * dx, eye[1] + depth * dy
            along, aside = x, y
            if nodes.shape[0] > 0:
                along, aside, _, _, _ = locate(nodes, cells, line, x, y)
            if not right_m <= aside <= left_m:
                continue
            sine = -dz / math.sqrt(dx * dx + dy * dy + dz * dz)
            fresnel = 0.03 + 0.97 * (1.0 - sine) ** 5
            puddle = 0.75 + 0.5 * noise_at(noise, 3.0 * along, 9.0 * aside)
            share = min(0.8, max(0.0, strength * fresnel * puddle))
            mirror = max(foot, horizon)
            for k in range(3):
                total = 0.0
                for i in range(5):
                    away = (v - mirror) * (1.0 + 0.08 * (i - 2))
                    row = min(max(int(mirror - away), 0), height - 1)
                    total += 0.2 * source[row, u, k]
                light[v, u, k] += share * (total - light[v, u, k])


def reflect(field: LightField, stage: Stage, road: Road, rain: float) -> None:
    """Makes carriageway and sidewalks wet; in place.

    Args:
        field: of a camera without roll.
        stage: of the run.
        road: the block.
        rain: 0 none, 1 a downpour.
    """
    bend = stage.bend
    _reflect(
        field.light.copy(), field.inverse_depth, field.view.position_m, field.rays,
        bend.nodes, bend.cells, bend.numbers, stage.noise,
        road.left_edge_m + road.sidewalk_left_m, road.right_edge_m - road.sidewalk_right_m,
        _STRENGTH * math.sqrt(rain), field.light,
    )  # fmt: skip
