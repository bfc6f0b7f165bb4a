"""Bodies of trucks and buses, fitted to the extents of an ObjectState; see vehicle_parts."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

from ssp_core.motion.state import Size
from ssp_ot_controller.camera.mesh import Colour, Mesh, Vec, box, join, quad
from ssp_ot_controller.camera.palettes import rgb
from ssp_ot_controller.camera.surfaces import GLASS, GLOSSY, LAMP, MATTE
from ssp_ot_controller.camera.vehicle_parts import (
    AMBER,
    PANE,
    PLASTIC,
    PLATE,
    Frame,
    Lights,
    arch,
    front_panel,
    left_panel,
    on_face,
    rear_panel,
    right_panel,
    wheel,
    wheel_step,
)

_RADIUS_M = 0.48  # of the wheels of both


def truck(size: Size, paint: Colour, lights: Lights, travelled_m: float = 0.0) -> Mesh:
    """A box truck: cab, gap, cargo box with rear doors, underrun guard."""
    return _truck(size, paint, lights, wheel_step(travelled_m, _RADIUS_M))


def bus(size: Size, paint: Colour, lights: Lights, travelled_m: float = 0.0) -> Mesh:
    """A city bus: one long body with a band of windows, doors on the right, a destination sign."""
    return _bus(size, paint, lights, wheel_step(travelled_m, _RADIUS_M))


@lru_cache(maxsize=128)
def _truck(size: Size, paint: Colour, lights: Lights, step: int) -> Mesh:
    f = Frame(size)
    wheels = [
        wheel(x, side * f.y(0.98), _RADIUS_M, 0.32, side, step)
        for side in (-1.0, 1.0)
        for x in (0.0, f.x(0.86))
    ]
    return join([_truck_body(size, paint, lights), *wheels])


@lru_cache(maxsize=64)
def _truck_body(size: Size, paint: Colour, lights: Lights) -> Mesh:
    f = Frame(size)
    cargo = rgb("d9dad6")
    frame_z = 0.95
    tail, tail_kind = lights.tail
    head, head_kind = lights.head
    cab0, cab1 = f.x(0.77), f.x(1.0)
    cab_top = 0.86 * size.height_m
    low = [
        (cab0, -f.y(0.96), 0.45),
        (cab1, -f.y(0.96), 0.45),
        (cab1, f.y(0.96), 0.45),
        (cab0, f.y(0.96), 0.45),
    ]
    middle = [(x, y, 1.55) for x, y, _ in low]
    slope = 0.28
    high = [
        (cab0, -f.y(0.9), cab_top),
        (cab1 - slope, -f.y(0.9), cab_top),
        (cab1 - slope, f.y(0.9), cab_top),
        (cab0, f.y(0.9), cab_top),
    ]
    parts = [
        _solid(low, middle, paint, GLOSSY),
        _solid(middle, high, paint, GLOSSY),
        on_face(
            (middle[1], middle[2], high[2], high[1]),
            (0.06, 0.94),
            (0.05, 0.78),
            PANE,
            GLASS,
        ),
        on_face((middle[2], middle[3], high[3], high[2]), (0.1, 0.62), (0.05, 0.7), PANE, GLASS),
        on_face((middle[0], middle[1], high[1], high[0]), (0.38, 0.9), (0.05, 0.7), PANE, GLASS),
        front_panel(cab1 + 0.01, -f.y(0.6), f.y(0.6), 0.85, 1.4, PLASTIC, MATTE),
        front_panel(cab1 + 0.01, -f.y(0.95), f.y(0.95), 0.45, 0.65, PLASTIC, MATTE),
        box((f.x(0.0), f.x(0.75)), (-f.y(1.0), f.y(1.0)), (frame_z, size.height_m), cargo, MATTE),
        box((f.x(0.01), f.x(0.8)), (-f.y(0.4), f.y(0.4)), (0.5, frame_z), PLASTIC, MATTE),
        box((f.x(0.0), f.x(0.012)), (-f.y(0.95), f.y(0.95)), (0.42, 0.58), PLASTIC, MATTE),
    ]
    rear = f.x(0.0) - 0.008
    parts += [  # frame and hinge line of the rear doors
        rear_panel(rear, f.y(y), f.y(y + 0.04), frame_z, size.height_m, rgb("8d908f"), MATTE)
        for y in (-0.97, -0.02, 0.93)
    ]
    parts.append(
        rear_panel(
            rear - 0.004, -f.y(0.96), f.y(0.96), frame_z, frame_z + 0.12, rgb("b23a34"), MATTE
        )
    )
    parts.append(rear_panel(rear - 0.004, -f.y(0.2), f.y(0.2), 0.6, 0.72, PLATE, MATTE))
    band = (frame_z + 0.25 * (size.height_m - frame_z), frame_z + 0.45 * (size.height_m - frame_z))
    parts.append(left_panel(f.y(1.0) + 0.008, f.x(0.03), f.x(0.72), *band, paint, MATTE))
    parts.append(right_panel(-f.y(1.0) - 0.008, f.x(0.03), f.x(0.72), *band, paint, MATTE))
    for side in (-1.0, 1.0):
        y0, y1 = sorted((side * f.y(0.6), side * f.y(0.94)))
        parts.append(rear_panel(rear - 0.004, y0, y1, 0.62, 0.84, tail, tail_kind))
        parts.append(front_panel(cab1 + 0.012, y0, y1, 0.7, 0.9, head, head_kind))
        mirror = sorted((side * f.y(1.0), side * f.y(1.15)))
        parts.append(
            box((cab1 - 0.35, cab1 - 0.25), (mirror[0], mirror[1]), (1.7, 2.3), PLASTIC, MATTE)
        )
        turn, turn_kind = lights.turn(side)
        y0, y1 = sorted((side * f.y(0.74), side * f.y(0.96)))
        parts.append(rear_panel(rear - 0.008, y0, y1, 0.6, 0.72, turn, turn_kind))
        y0, y1 = sorted((side * f.y(0.78), side * f.y(0.96)))
        parts.append(front_panel(cab1 + 0.014, y0, y1, 0.92, 1.06, turn, turn_kind))
        flank_panel = left_panel if side > 0.0 else right_panel
        y = side * (f.y(0.96) + 0.012)
        parts.append(flank_panel(y, cab1 - 0.45, cab1 - 0.2, 1.3, 1.42, turn, turn_kind))
    return join(parts)


def _solid(low: Sequence[Vec], high: Sequence[Vec], colour: Colour, kind: int) -> Mesh:
    """A solid between two rectangles, each counter-clockwise as seen from above."""
    faces = [quad(high[0], high[1], high[2], high[3], colour, kind)]
    for i in range(4):
        j = (i + 1) % 4
        faces.append(quad(low[i], low[j], high[j], high[i], colour, kind))
    return join(faces)


@lru_cache(maxsize=128)
def _bus(size: Size, paint: Colour, lights: Lights, step: int) -> Mesh:
    f = Frame(size)
    wheels = [
        wheel(x, side * (f.y(1.0) + 0.016), _RADIUS_M, 0.3, side, step)
        for side in (-1.0, 1.0)
        for x in (0.0, f.x(0.79))
    ]
    return join([_bus_body(size, paint, lights), *wheels])


@lru_cache(maxsize=64)
def _bus_body(size: Size, paint: Colour, lights: Lights) -> Mesh:
    f = Frame(size)
    floor = 0.32
    tail, tail_kind = lights.tail
    head, head_kind = lights.head
    top = size.height_m
    window = (0.42 * top, 0.82 * top)
    left, right = f.y(1.0) + 0.01, -f.y(1.0) - 0.01
    rear, front = f.x(0.0) - 0.01, f.x(1.0) + 0.01
    roof = rgb("dcdcd8")
    parts = [
        box((f.x(0.0), f.x(1.0)), (-f.y(1.0), f.y(1.0)), (floor, 0.9 * top), paint, GLOSSY),
        _solid(
            [(f.x(0.0), -f.y(1.0), 0.9 * top), (f.x(1.0), -f.y(1.0), 0.9 * top),
             (f.x(1.0), f.y(1.0), 0.9 * top), (f.x(0.0), f.y(1.0), 0.9 * top)],
            [(f.x(0.01), -f.y(0.88), top), (f.x(0.99), -f.y(0.88), top),
             (f.x(0.99), f.y(0.88), top), (f.x(0.01), f.y(0.88), top)],
            roof,
            MATTE,
        ),
        rear_panel(rear, -f.y(0.86), f.y(0.86), 0.52 * top, 0.82 * top, PANE, GLASS),
        rear_panel(rear, -f.y(0.8), f.y(0.8), 0.26 * top, 0.44 * top, rgb("3b3e42"), MATTE),
        rear_panel(rear - 0.004, -f.y(0.2), f.y(0.2), 0.17 * top, 0.21 * top, PLATE, MATTE),
        rear_panel(rear, -f.y(0.3), f.y(0.3), 0.84 * top, 0.9 * top, AMBER, LAMP),
        front_panel(front, -f.y(0.92), f.y(0.92), 0.36 * top, 0.8 * top, PANE, GLASS),
        front_panel(front, -f.y(0.7), f.y(0.7), 0.82 * top, 0.9 * top, AMBER, LAMP),
        front_panel(front, -f.y(0.98), f.y(0.98), floor, 0.18 * top, PLASTIC, MATTE),
    ]  # fmt: skip
    panes = 7
    for i in range(panes):
        x0 = f.x(0.02 + 0.95 * i / panes)
        x1 = f.x(0.02 + 0.95 * (i + 0.92) / panes)
        parts.append(left_panel(left, x0, x1, *window, PANE, GLASS))
        door = i in (3, 6)
        low = 0.45 if door else window[0]
        parts.append(right_panel(right, x0, x1, low, window[1], PANE, GLASS))
    for side in (-1.0, 1.0):
        turn, turn_kind = lights.turn(side)
        y0, y1 = sorted((side * f.y(0.68), side * f.y(0.97)))
        parts.append(rear_panel(rear - 0.002, y0, y1, 0.22 * top, 0.45 * top, PLASTIC, MATTE))
        y0, y1 = sorted((side * f.y(0.72), side * f.y(0.94)))
        parts.append(rear_panel(rear - 0.004, y0, y1, 0.24 * top, 0.34 * top, tail, tail_kind))
        parts.append(rear_panel(rear - 0.004, y0, y1, 0.37 * top, 0.43 * top, turn, turn_kind))
        y0, y1 = sorted((side * f.y(0.76), side * f.y(0.96)))
        parts.append(front_panel(front + 0.004, y0, y1, 0.29 * top, 0.34 * top, turn, turn_kind))
        y = left if side > 0.0 else right
        flank_panel = left_panel if side > 0.0 else right_panel
        parts.append(flank_panel(y, f.x(0.93), f.x(0.955), 0.3 * top, 0.345 * top, turn, turn_kind))
        y0, y1 = sorted((side * f.y(0.72), side * f.y(0.94)))
        parts.append(front_panel(front + 0.004, y0, y1, 0.2 * top, 0.27 * top, head, head_kind))
        mirror = sorted((side * f.y(1.0), side * f.y(1.16)))
        parts.append(
            box(
                (f.x(1.0), f.x(1.012)),
                (mirror[0], mirror[1]),
                (0.55 * top, 0.72 * top),
                PLASTIC,
                MATTE,
            )
        )
        for x in (0.0, f.x(0.79)):
            y = side * (f.y(1.0) + 0.012)
            parts.append(arch(x, y, 1.2 * _RADIUS_M, floor, side))
    return join(parts)
