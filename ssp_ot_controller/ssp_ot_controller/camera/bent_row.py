"""Colours of the ground along one image row of a road that bends.

As ground_row, but each place on the ground is taken to the line's arc length and offset first, and
so is its footprint.
"""

from __future__ import annotations

from ssp_ot_controller.camera import ground
from ssp_ot_controller.camera.bend import locate
from ssp_ot_controller.camera.ground_colour import ground_colour
from ssp_ot_controller.camera.ground_row import (
    BLOCK,
    FINE_M,
    KERB_FACE,
    fill_plain,
    meets,
    patches,
    plain_strip,
)
from ssp_ot_controller.camera.jit import Array, inlined
from ssp_ot_controller.camera.surfaces import noise_at


@inlined
def _footprint(
    c: float, w: float, stretch: float, t: float, dx: float, dy: float, growth: float, rays: Array
) -> tuple[float, float]:
    """Extents along and across the line of a pixel that meets the ground at t times (dx, dy)."""
    ax, ay = t * rays[1, 0], t * rays[1, 1]
    bx, by = t * (growth * dx + rays[2, 0]), t * (growth * dy + rays[2, 1])
    along = (abs(c * ax + w * ay) + abs(c * bx + w * by)) / stretch
    across = abs(c * ay - w * ax) + 0.5 * abs(c * by - w * bx)
    return max(along, ground.CELL_M), max(across, ground.CELL_M)


@inlined
def _meet(
    nodes: Array,
    cells: Array,
    line: Array,
    numbers: Array,
    position: Array,
    road_depth: float,
    raised_depth: float,
    dx: float,
    dy: float,
) -> tuple[int, float, float, float, float, float]:
    """What a ray meets, as ``meets`` says, and the place there, as ``locate`` does."""
    x, y = position[0] + road_depth * dx, position[1] + road_depth * dy
    s, offset, c, w, stretch = locate(nodes, cells, line, x, y)
    # Offsets of two places differ by no more than the places are apart.
    apart = (road_depth - raised_depth) * (abs(dx) + abs(dy))
    left, right = numbers[ground.P_LEFT_EDGE], numbers[ground.P_RIGHT_EDGE]
    if right + apart < offset < left - apart:
        return 0, s, offset, c, w, stretch
    x, y = position[0] + raised_depth * dx, position[1] + raised_depth * dy
    rs, raised, rc, rw, rstretch = locate(nodes, cells, line, x, y)
    plane = meets(raised, offset, numbers)
    if plane == 1:
        return 1, rs, raised, rc, rw, rstretch
    return plane, s, offset, c, w, stretch


@inlined
def bent_row(
    sums: Array,
    strips: Array,
    values: Array,
    numbers: Array,
    nodes: Array,
    cells: Array,
    line: Array,
    noise: Array,
    position: Array,
    start: Array,
    rays: Array,
    hidden: Array,
    row: Array,
) -> None:
    """Colours of one image row below the horizon, without light and fog.

    Args:
        sums, strips, values: see ground.Tables.
        numbers: vector of ground.build_parameters.
        nodes, cells, line: see bend.Bend.
        noise: tileable noise.
        position: camera centre, block frame.
        start: ray direction at column 0; its z is negative.
        rays: shape (3, 3): direction at pixel (0, 0), and its change per column and per row.
        hidden: shape (width,); pixels where it is true may be left out.
        row: shape (3 width,), blue, green, red in turn; filled.
    """
    textured = numbers[ground.P_TEXTURE] > 0.0
    crossing = numbers[ground.P_CROSSING_X]
    road_depth = -position[2] / start[2]
    raised_depth = (ground.KERB_HEIGHT_M - position[2]) / start[2]
    growth = -rays[2, 2] / start[2]  # of the depth per row, over the depth
    width = hidden.shape[0]
    patch_end, fine_end, code_end, s_end, l_end = 0.0, 0.0, -1, 0.0, 0.0
    for first in range(-BLOCK, width, BLOCK):
        patch, fine, code, s_begin, l_begin = patch_end, fine_end, code_end, s_end, l_end
        dx, dy = start[0] + (first + BLOCK) * rays[1, 0], start[1] + (first + BLOCK) * rays[1, 1]
        plane, s_end, l_end, c, w, stretch = _meet(
            nodes, cells, line, numbers, position, road_depth, raised_depth, dx, dy
        )
        t = raised_depth if plane == 1 else road_depth
        ws, wl = _footprint(c, w, stretch, t, dx, dy, growth, rays)
        if textured:
            patch_end = patches(noise, s_end, l_end, max(ws, wl))
            fine_end = 1.0 - max(ws, wl) / FINE_M
        code_end = -1
        if plane != 2:
            code_end = plain_strip(strips, values, crossing, s_end, l_end, ws, wl)
            if code_end >= 0:
                code_end = 2 * code_end + plane
        if code >= 0 and code == code_end and first + BLOCK <= width:
            fill_plain(
                values, code >> 2, noise, s_begin, (s_end - s_begin) / BLOCK, l_begin,
                (l_end - l_begin) / BLOCK, patch, (patch_end - patch) / BLOCK, fine,
                (fine_end - fine) / BLOCK, row[3 * first : 3 * (first + BLOCK)],
            )  # fmt: skip
            continue
        for u in range(max(first, 0), min(first + BLOCK, width)):
            if hidden[u]:
                continue
            dx, dy = start[0] + u * rays[1, 0], start[1] + u * rays[1, 1]
            plane, s, offset, c, w, stretch = _meet(
                nodes, cells, line, numbers, position, road_depth, raised_depth, dx, dy
            )
            if plane == 2:
                for k in range(3):
                    row[3 * u + k] = KERB_FACE * numbers[ground.P_KERB_B + k]
                continue
            t = raised_depth if plane == 1 else road_depth
            ws, wl = _footprint(c, w, stretch, t, dx, dy, growth, rays)
            grain = 0.0
            if textured:
                grain = patch + (u - first) / BLOCK * (patch_end - patch)
                near = 1.0 - max(ws, wl) / FINE_M
                if near > 0.0:
                    grain += 1.3 * near * noise_at(noise, 60.0 * s, 60.0 * offset)
            blue, green, red = ground_colour(
                sums, strips, values, numbers, s, offset, ws, wl, grain
            )
            row[3 * u], row[3 * u + 1], row[3 * u + 2] = blue, green, red
