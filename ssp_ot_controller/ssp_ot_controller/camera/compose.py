"""Puts a frame together: ground and sky behind the drawn objects, fog, sensor noise."""

from __future__ import annotations

import math

import numpy as np

from ssp_ot_controller.camera import ground
from ssp_ot_controller.camera.ground import shade_ground
from ssp_ot_controller.camera.jit import Array, compiled, inlined
from ssp_ot_controller.camera.sky import sky_row

SAMPLES = 2  # per pixel and axis

# Layout of the vector of numbers that compose wants.
C_FOG, C_SHADOW, C_FOG_PER_M, C_EXPOSURE, C_NOISE, C_VIGNETTE = 0, 3, 6, 7, 8, 9
PARAMETERS = 10

_LEVEL = -1e-4  # rays that fall less than this per metre are taken for level


@compiled
def contact(boxes: Array, position: Array, rays: Array, reach_m: float, dark: Array) -> None:
    """Darkens the ground under and close around bodies, where little light gets.

    Args:
        boxes: shape (n, 7): x, y, cos yaw, sin yaw, front, rear, half width (block frame, m).
        position: camera centre, block frame.
        rays: shape (3, 3): direction at pixel (0, 0), and its change per column and per row.
        reach_m: distance from the box at which the darkening ends.
        dark: shape (height, width), 0 none to 1; updated.
    """
    height, width = dark.shape
    for n in range(boxes.shape[0]):
        x0, y0, c, s, front, rear, half = boxes[n]
        radius = max(front, rear) + half + reach_m
        for v in range(height):
            dz = rays[0, 2] + v * rays[2, 2]
            if dz >= _LEVEL:
                continue
            t = -position[2] / dz
            # The ground point of a row moves on a line: skip the part away from the box.
            px = position[0] + t * (rays[0, 0] + v * rays[2, 0]) - x0
            py = position[1] + t * (rays[0, 1] + v * rays[2, 1]) - y0
            ux, uy = t * rays[1, 0], t * rays[1, 1]
            step = ux * ux + uy * uy
            middle = -(px * ux + py * uy) / step
            off = (px + middle * ux) ** 2 + (py + middle * uy) ** 2
            if off > radius * radius:
                continue
            spread = math.sqrt((radius * radius - off) / step)
            first = max(0, math.ceil(middle - spread))
            last = min(width - 1, math.floor(middle + spread))
            for u in range(first, last + 1):
                qx, qy = px + u * ux, py + u * uy
                along, across = c * qx + s * qy, abs(-s * qx + c * qy)
                outside = max(along - front, -rear - along, 0.0)
                sideways = max(across - half, 0.0)
                gap = math.sqrt(outside * outside + sideways * sideways) / reach_m
                if gap < 1.0:
                    dark[v, u] = max(dark[v, u], (1.0 - gap) ** 2)


@inlined
def _mixed(state: np.uint64) -> np.uint64:
    """A well mixed 64-bit number (splitmix64)."""
    state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return state ^ (state >> np.uint64(31))


@compiled
def _ground_row(
    numbers: Array,
    tables: Array,
    ground_numbers: Array,
    noise: Array,
    position: Array,
    start: Array,
    rays: Array,
    shadow: Array,
    dark: Array,
    row: Array,
) -> None:
    """Colours of one image row below the horizon into ``row``, shape (width, 3).

    The camera doesn't roll, so that a row has one depth per horizontal plane; pixels whose
    ``shadow`` is negative are hidden and left out.
    """
    kerb = ground.KERB_HEIGHT_M
    left, right = ground_numbers[ground.P_LEFT_EDGE], ground_numbers[ground.P_RIGHT_EDGE]
    raised_left = ground_numbers[ground.P_LEFT_RAISED] > 0.0
    raised_right = ground_numbers[ground.P_RIGHT_RAISED] > 0.0
    dz = start[2]
    road_depth, raised_depth = -position[2] / dz, (kerb - position[2]) / dz
    road_clear = math.exp(-numbers[C_FOG_PER_M] * road_depth)
    # Growth of the depth per row, over the depth.
    growth = -rays[2, 2] / dz
    for u in range(row.shape[0]):
        if shadow[u] < 0.0:
            continue
        dx, dy = start[0] + u * rays[1, 0], start[1] + u * rays[1, 1]
        t = raised_depth
        y = position[1] + t * dy
        face = False
        if not ((raised_left and y > left) or (raised_right and y < right)):
            t = road_depth
            y = position[1] + t * dy
            face = (raised_left and y > left) or (raised_right and y < right)
        if face:
            blue = 0.72 * ground_numbers[ground.P_KERB_B]
            green = 0.72 * ground_numbers[ground.P_KERB_B + 1]
            red = 0.72 * ground_numbers[ground.P_KERB_B + 2]
        else:
            wx = t * (abs(rays[1, 0]) + abs(growth * dx + rays[2, 0]))
            wy = t * (abs(rays[1, 1]) + 0.5 * abs(growth * dy + rays[2, 1]))
            blue, green, red = shade_ground(
                tables, ground_numbers, noise, position[0] + t * dx, y, wx, wy
            )
        light = 1.0 - 0.6 * dark[u]
        row[u, 0] = blue * light
        row[u, 1] = green * light
        row[u, 2] = red * light
        for k in range(3):
            value = row[u, k] * (1.0 - shadow[u] * (1.0 - numbers[C_SHADOW + k]))
            row[u, k] = numbers[C_FOG + k] + road_clear * (value - numbers[C_FOG + k])


@compiled
def _resolve_samples(
    inverse_depth: Array, pixels: Array, cover: Array, v: int, total: Array, shadow: Array
) -> None:
    """Sums the drawn samples of one image row.

    Args:
        total: shape (width, 4): sums of blue, green, red, and the number of drawn samples.
        shadow: shape (width,): share of shadow on the ground, -1 where all samples are drawn.
    """
    for u in range(total.shape[0]):
        for k in range(4):
            total[u, k] = 0.0
        shaded = 0
        for j in range(SAMPLES * v, SAMPLES * v + SAMPLES):
            for i in range(SAMPLES * u, SAMPLES * u + SAMPLES):
                shaded += cover[j, i]
                if inverse_depth[j, i] > 0.0:
                    for k in range(3):
                        total[u, k] += pixels[j, i, k]
                    total[u, 3] += 1.0
        per_pixel = SAMPLES * SAMPLES
        shadow[u] = -1.0 if total[u, 3] == per_pixel else shaded / per_pixel


@compiled
def compose(
    numbers: Array,
    ground_tables: Array,
    ground_numbers: Array,
    panorama: Array,
    noise: Array,
    position: Array,
    rays: Array,
    inverse_depth: Array,
    pixels: Array,
    cover: Array,
    dark: Array,
    noise_state: np.uint64,
    out: Array,
) -> None:
    """Fills a frame.

    Args:
        numbers: vector of PARAMETERS: fog colour, shadow factor, fog, exposure, noise, vignette.
        ground_tables, ground_numbers, panorama, noise: see ground, sky and surfaces.
        position: camera centre, block frame.
        rays: shape (3, 3): direction at pixel (0, 0), and its change per column and per row.
        inverse_depth, pixels: what was drawn, SAMPLES times finer than the frame.
        cover: shadow on the ground, equally fine.
        dark: contact darkening, shape of the frame.
        noise_state: start of the sensor noise of this frame.
        out: shape (height, width, 3), uint8 blue, green, red.
    """
    height, width, _ = out.shape
    row, total, shadow = np.empty((width, 3)), np.empty((width, 4)), np.empty(width)
    start = np.empty(3)
    per_pixel = SAMPLES * SAMPLES
    corner = 1.0 / ((0.5 * width) ** 2 + (0.5 * height) ** 2)
    for v in range(height):
        for k in range(3):
            start[k] = rays[0, k] + v * rays[2, k]
        _resolve_samples(inverse_depth, pixels, cover, v, total, shadow)
        if start[2] >= _LEVEL:
            sky_row(panorama, start, rays[1], shadow, row)
        else:
            _ground_row(
                numbers, ground_tables, ground_numbers, noise, position, start, rays, shadow,
                dark[v], row,
            )  # fmt: skip
        for u in range(width):
            behind = per_pixel - total[u, 3]
            dx, dy = u - 0.5 * (width - 1), v - 0.5 * (height - 1)
            gain = numbers[C_EXPOSURE] / per_pixel
            gain *= 1.0 - numbers[C_VIGNETTE] * (dx * dx + dy * dy) * corner
            grain = _mixed(noise_state + np.uint64(v * width + u) * np.uint64(0x9E3779B97F4A7C15))
            for k in range(3):
                value = total[u, k]
                if behind > 0.0:
                    value += behind * row[u, k]
                # Sum of two uniform bytes: mean 255, standard deviation 104.5.
                two = (grain >> np.uint64(16 * k)) & np.uint64(255)
                two += (grain >> np.uint64(16 * k + 8)) & np.uint64(255)
                value = gain * value + numbers[C_NOISE] * (float(two) - 255.0) / 104.5
                out[v, u, k] = np.uint8(min(255.0, max(0.0, value + 0.5)))
