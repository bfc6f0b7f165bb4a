"""Traffic signs: those of a map, and those that a road's own numbers call for.

A sign's mesh faces along -x, towards drivers who go along x.
"""

from __future__ import annotations

import math

import numpy as np

from ssp_core.run_file.road import Sign
from ssp_ot_controller.camera.mesh import Colour, Mesh, Vec, box, fan, join, quad, triangles, tube
from ssp_ot_controller.camera.palettes import rgb

_POLE = rgb("8d9296")
_BACK = rgb("9aa0a4")
_RED, _WHITE = rgb("c81e24"), rgb("f2f2f0")
_BLUE, _BLACK = rgb("1f5fae"), rgb("17181a")
_RADIUS_M = 0.42
_MIDDLE_M = 2.5  # above the ground
_SIDE_M = 0.8  # of the square sign
_LIFT_M = 0.006
_SIDES = 20

# Bars of a digit: top, upper left and right, middle, lower left and right, bottom.
_BARS = {
    "0": "1110111", "1": "0010010", "2": "1011101", "3": "1011011", "4": "0111010",
    "5": "1101011", "6": "1101111", "7": "1010010", "8": "1111111", "9": "1111011",
}  # fmt: skip


def _post(x: float = 0.05) -> Mesh:
    return tube((x, 0, 0), (x, 0, _MIDDLE_M + 0.3), 0.035, 0.035, _POLE, 6)


def _panel(y0: float, y1: float, z0: float, z1: float, lift: int, colour: Colour) -> Mesh:
    """A rectangle that faces along -x; ``lift`` says what lies over what."""
    x = -_LIFT_M * lift
    return quad((x, y1, z0), (x, y0, z0), (x, y0, z1), (x, y1, z1), colour)


def _disc(
    radius_m: float, lift: int, colour: Colour, sides: int = _SIDES, first_rad: float = 0.0
) -> Mesh:
    """A regular polygon, with a corner at first_rad from its right hand side."""
    angles = 2.0 * np.pi * np.arange(sides) / sides + first_rad
    outline: list[Vec] = [
        (-_LIFT_M * lift, -radius_m * math.cos(a), _MIDDLE_M + radius_m * math.sin(a))
        for a in angles
    ]
    return fan(outline, colour)


def _bars(marks: str, left_m: float, width_m: float, height_m: float, colour: Colour) -> list[Mesh]:
    """Seven bars, those that are on; y falls from left to right for who looks along x."""
    bar = 0.24 * width_m
    y0, y1 = left_m - width_m, left_m
    low, high = _MIDDLE_M - height_m / 2, _MIDDLE_M + height_m / 2
    middle = _MIDDLE_M
    places = (
        (y0, y1, high - bar, high),
        (y1 - bar, y1, middle, high),
        (y0, y0 + bar, middle, high),
        (y0, y1, middle - bar / 2, middle + bar / 2),
        (y1 - bar, y1, low, middle),
        (y0, y0 + bar, low, middle),
        (y0, y1, low, low + bar),
    )
    return [_panel(*place, 3, colour) for place, on in zip(places, marks, strict=True) if on == "1"]


def speed_limit(kmh: int) -> Mesh:
    """A round sign with a red border and a number."""
    text = str(kmh)
    width, gap, height = 0.19, 0.07, 0.36
    if len(text) > 2:
        width, gap, height = 0.13, 0.05, 0.3
    total = len(text) * width + (len(text) - 1) * gap
    digits: list[Mesh] = []
    for i, one in enumerate(text):
        digits += _bars(_BARS[one], total / 2 - i * (width + gap), width, height, _BLACK)
    back = triangles(_disc(_RADIUS_M, -1, _BACK).corners[:, ::-1], _BACK)
    return join(
        [_post(), back, _disc(_RADIUS_M, 1, _RED), _disc(0.78 * _RADIUS_M, 2, _WHITE), *digits]
    )


def _plate(radius_m: float, sides: int, first_rad: float, rims: tuple[Colour, ...]) -> Mesh:
    """A polygon on a post, of rings of colour from outside to inside, with a grey back."""
    front = [
        _disc(radius_m * (1.0 - 0.16 * k), k + 1, colour, sides, first_rad)
        for k, colour in enumerate(rims)
    ]
    back = _disc(radius_m, -1, _BACK, sides, first_rad)
    return join([_post(), triangles(back.corners[:, ::-1], _BACK), *front])


def stop() -> Mesh:
    """A red octagon with a white border and the word."""
    plate = _plate(0.48, 8, math.pi / 8, (_WHITE, _RED))
    width, gap, high = 0.12, 0.045, 0.13
    bar = 0.3 * width
    letters: list[Mesh] = []
    # Bars as of digits; the T's upright stands in its middle.
    for i, on in enumerate(("1101011", "1000000", "1110111", "1111100")):
        left = 2 * width + 1.5 * gap - i * (width + gap)
        letters += _bars(on, left, width, 2 * high, _WHITE)
        if i == 1:
            middle = left - width / 2
            letters.append(
                _panel(middle - bar / 2, middle + bar / 2, _MIDDLE_M - high, _MIDDLE_M + high, 3,
                       _WHITE)
            )  # fmt: skip
    return join([plate, *letters])


def give_way() -> Mesh:
    """A triangle that stands on its point, white with a red border."""
    plate = _plate(0.5, 3, -math.pi / 2, (_RED,))
    return join([plate, _disc(0.32, 2, _WHITE, 3, -math.pi / 2)])


def plain() -> Mesh:
    """A plate that says nothing: of a sign that is none of the others."""
    return _plate(0.45, 4, math.pi / 4, (_BLACK, _WHITE))


def sign_of(sign: Sign) -> Mesh:
    """The mesh of a map's sign."""
    if sign.kind == "speed_limit" and sign.value is not None:
        return speed_limit(sign.value)
    made = {"crossing": crossing, "stop": stop, "yield": give_way}
    return made.get(sign.kind, plain)()


def crossing() -> Mesh:
    """A blue square with a white triangle and somebody who walks in it."""
    h, z = _SIDE_M / 2, _MIDDLE_M
    x = -2 * _LIFT_M
    triangle = triangles([(x, 0.34, z - 0.29), (x, -0.34, z - 0.29), (x, 0.0, z + 0.31)], _WHITE)

    def limb(a: tuple[float, float], b: tuple[float, float], wide: float) -> Mesh:
        away = np.subtract(b, a)
        across = wide / 2 * np.array([-away[1], away[0]]) / np.linalg.norm(away)
        corners = (np.add(a, across), np.subtract(a, across), np.subtract(b, across),
                   np.add(b, across))  # fmt: skip
        p, q, r, t = ((-3 * _LIFT_M, float(y), float(z + up)) for y, up in corners)
        # Whichever way round: both sides of so thin a thing are drawn.
        return join([quad(p, q, r, t, _BLACK), quad(t, r, q, p, _BLACK)])

    figure = [
        limb((0.0, 0.1), (0.0, -0.06), 0.075),
        limb((0.0, -0.05), (0.11, -0.27), 0.05),
        limb((0.0, -0.05), (-0.11, -0.27), 0.05),
        limb((0.0, 0.06), (0.12, -0.04), 0.035),
        limb((0.0, 0.06), (-0.12, -0.04), 0.035),
        limb((0.0, 0.19), (0.0, 0.11), 0.075),
    ]
    plate = box((0.0, 0.012), (-h, h), (z - h, z + h), _BACK)
    return join([_post(), plate, _panel(-h, h, z - h, z + h, 1, _BLUE), triangle, *figure])
