"""Colours of the ground along one image row.

The camera doesn't roll, so that a row has one depth per horizontal plane, and places on the ground
are linear in the column.
"""

from __future__ import annotations

from ssp_ot_controller.camera import ground
from ssp_ot_controller.camera.ground_colour import CELLS_PER_M, CROSSING_REACH_M, ground_colour
from ssp_ot_controller.camera.jit import Array, inlined
from ssp_ot_controller.camera.surfaces import noise_at

BLOCK = 8  # pixels between which patches are linear: they are wider than that
FINE_M = 0.12  # footprint from which on fine grain isn't resolved
KERB_FACE = 0.72  # its light


@inlined
def patches(noise: Array, x_m: float, y_m: float, footprint_m: float) -> float:
    """Light and dark patches; each scale fades before a pixel can no longer resolve it."""
    middle = 1.0 - footprint_m / 1.5
    coarse = 1.0 - footprint_m / 12.0
    patch = 0.0
    if coarse > 0.0:
        patch += 0.8 * coarse * noise_at(noise, 0.45 * x_m, 1.1 * y_m)
    if middle > 0.0:
        patch += 0.9 * middle * noise_at(noise, 4.0 * x_m + 31.0, 4.0 * y_m)
    return patch


@inlined
def plain_strip(
    strips: Array, values: Array, crossing: float, x: float, y: float, wx: float, wy: float
) -> int:
    """A number for the ground around a footprint if it has one colour but for grain, else -1.

    Footprints with the same number have the same colour, and so has the ground between them.
    """
    last = strips.shape[1] - 1
    low = (y - wy / 2 + ground.HALF_WIDTH_M) * CELLS_PER_M
    high = (y + wy / 2 + ground.HALF_WIDTH_M) * CELLS_PER_M
    strip = strips[0, int(min(max(low, 0.0), float(last)))]
    if strip != strips[0, int(min(max(high, 0.0), float(last)))]:
        return -1
    if values[0, strip, ground.DASHED] > 0.0 or values[0, strip, ground.PAVING] > 0.0:
        return -1
    if abs(x - crossing) < CROSSING_REACH_M + wx / 2:
        return -1
    return 2 * int(strip) + int(x > crossing)


@inlined
def fill_plain(
    values: Array,
    strip: int,
    noise: Array,
    x: float,
    x_step: float,
    y: float,
    y_step: float,
    patch: float,
    patch_step: float,
    fine: float,
    fine_step: float,
    row: Array,
) -> None:
    """Pixels of one strip: its colour and grain, whose shares change by steps along the row."""
    blue, green, red = values[0, strip, 0], values[0, strip, 1], values[0, strip, 2]
    strength = values[0, strip, ground.GRAIN]
    if fine <= 0.0 and fine + BLOCK * fine_step <= 0.0:
        for k in range(BLOCK):
            grain = strength * (patch + k * patch_step)
            row[3 * k], row[3 * k + 1], row[3 * k + 2] = blue + grain, green + grain, red + grain
        return
    for k in range(BLOCK):
        share = 1.3 * max(0.0, fine + k * fine_step)
        at = noise_at(noise, 60.0 * (x + k * x_step), 60.0 * (y + k * y_step))
        grain = strength * (patch + k * patch_step + share * at)
        row[3 * k], row[3 * k + 1], row[3 * k + 2] = blue + grain, green + grain, red + grain


@inlined
def meets(y_raised: float, y_road: float, numbers: Array) -> int:
    """What a ray meets: 0 the road's level, 1 the raised sidewalks, 2 the face of a kerb."""
    left, right = numbers[ground.P_LEFT_EDGE], numbers[ground.P_RIGHT_EDGE]
    raised_left = numbers[ground.P_LEFT_RAISED] > 0.0
    raised_right = numbers[ground.P_RIGHT_RAISED] > 0.0
    if (raised_left and y_raised > left) or (raised_right and y_raised < right):
        return 1
    if (raised_left and y_road > left) or (raised_right and y_road < right):
        return 2
    return 0


@inlined
def ground_row(
    sums: Array,
    strips: Array,
    values: Array,
    numbers: Array,
    noise: Array,
    position: Array,
    start: Array,
    rays: Array,
    hidden: Array,
    row: Array,
) -> None:
    """Colours of one image row below the horizon, without light and fog.

    Most of the ground has one colour but for its grain: where both ends of a block of pixels lie
    in one strip, so does all between them.

    Args:
        sums, strips, values: see ground.Tables.
        numbers: vector of ground.build_parameters.
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
    across_x, across_y = abs(rays[1, 0]), abs(rays[1, 1])
    width = hidden.shape[0]
    patch_end, fine_end, code_end = 0.0, 0.0, -1
    for first in range(-BLOCK, width, BLOCK):
        patch, fine, code = patch_end, fine_end, code_end
        dx, dy = start[0] + (first + BLOCK) * rays[1, 0], start[1] + (first + BLOCK) * rays[1, 1]
        plane = meets(position[1] + raised_depth * dy, position[1] + road_depth * dy, numbers)
        t = raised_depth if plane == 1 else road_depth
        wx = max(t * (across_x + abs(growth * dx + rays[2, 0])), ground.CELL_M)
        wy = max(t * (across_y + 0.5 * abs(growth * dy + rays[2, 1])), ground.CELL_M)
        x, y = position[0] + t * dx, position[1] + t * dy
        if textured:
            patch_end = patches(noise, x, y, max(wx, wy))
            fine_end = 1.0 - max(wx, wy) / FINE_M
        code_end = -1
        if plane != 2:
            code_end = plain_strip(strips, values, crossing, x, y, wx, wy)
            if code_end >= 0:
                code_end = 2 * code_end + plane
        if code >= 0 and code == code_end and first + BLOCK <= width:
            fill_plain(
                values, code >> 2, noise, x - BLOCK * t * rays[1, 0], t * rays[1, 0],
                y - BLOCK * t * rays[1, 1], t * rays[1, 1], patch, (patch_end - patch) / BLOCK,
                fine, (fine_end - fine) / BLOCK, row[3 * first : 3 * (first + BLOCK)],
            )  # fmt: skip
            continue
        for u in range(max(first, 0), min(first + BLOCK, width)):
            if hidden[u]:
                continue
            dx, dy = start[0] + u * rays[1, 0], start[1] + u * rays[1, 1]
            plane = meets(position[1] + raised_depth * dy, position[1] + road_depth * dy, numbers)
            if plane == 2:
                for k in range(3):
                    row[3 * u + k] = KERB_FACE * numbers[ground.P_KERB_B + k]
                continue
            t = raised_depth if plane == 1 else road_depth
            x, y = position[0] + t * dx, position[1] + t * dy
            wx = max(t * (across_x + abs(growth * dx + rays[2, 0])), ground.CELL_M)
            wy = max(t * (across_y + 0.5 * abs(growth * dy + rays[2, 1])), ground.CELL_M)
            grain = 0.0
            if textured:
                grain = patch + (u - first) / BLOCK * (patch_end - patch)
                near = 1.0 - max(wx, wy) / FINE_M
                if near > 0.0:
                    grain += 1.3 * near * noise_at(noise, 60.0 * x, 60.0 * y)
            blue, green, red = ground_colour(sums, strips, values, numbers, x, y, wx, wy, grain)
            row[3 * u], row[3 * u + 1], row[3 * u + 2] = blue, green, red
