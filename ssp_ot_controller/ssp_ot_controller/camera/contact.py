"""Darkening of the ground under and around bodies."""

from __future__ import annotations

import math

from ssp_ot_controller.camera.jit import Array, compiled

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
