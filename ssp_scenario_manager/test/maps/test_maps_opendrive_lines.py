"""Reference lines of OpenDRIVE maps: exact, fitted within a centimetre, or refused."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ssp_core.geometry import FloatArray
from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.maps.block import Library
from ssp_scenario_manager.maps.load import load_library
from ssp_scenario_manager.maps.routes import routes_of
from tests.support.events.map_blocks import blocks, only

Made = Any
Words = Any


def test_lines_arcs_and_spirals_are_exact(made: Made, words: Words) -> None:
    geometry = words.at(10, 20, 0.5, 30)
    made.road("a", 30, geometry=geometry)
    first = only(load_library(made.write()), "road a forward").line
    end = first.pose(30.0)
    shapes = ['<arc curvature="0.02"/>', '<spiral curvStart="0.02" curvEnd="-0.01"/>', "<line/>"]
    text, s = geometry, 30.0
    pose = end
    line = first
    for shape, length in zip(shapes, (25.0, 40.0, 20.0), strict=True):
        text += words.at(pose.x_m, pose.y_m, pose.yaw_rad, length, shape, s)
        s += length
        made.parts.clear()
        made.road("a", s, geometry=text)
        line = only(load_library(made.write()), "road a forward").line
        pose = line.pose(s)
    assert [(p.length_m, p.start_curvature_1pm, p.end_curvature_1pm) for p in line.pieces] == [
        (30.0, 0.0, 0.0),
        (25.0, 0.02, 0.02),
        (40.0, 0.02, -0.01),
        (20.0, 0.0, 0.0),
    ]


def poly3(numbers: list[float], u: FloatArray) -> FloatArray:
    a, b, c, d = numbers
    return np.stack([u, a + b * u + c * u**2 + d * u**3], axis=1)


def length_of(places: FloatArray) -> float:
    return float(np.hypot(*np.diff(places, axis=0).T).sum())


def turned(places: FloatArray) -> FloatArray:
    """Transform places from the frame of a geometry at (5, -3), heading 0.7, to the map's."""
    c, s = math.cos(0.7), math.sin(0.7)
    found: FloatArray = places @ np.array([[c, s], [-s, c]]) + [5.0, -3.0]
    return found


def test_a_poly3_is_fitted_within_a_centimetre(made: Made, words: Words) -> None:
    numbers = [0.0, 0.0, 0.008, -0.00008]
    places = poly3(numbers, np.linspace(0.0, 60.0, 60001))
    length = length_of(places)
    assert length > 61.0  # so that u and arc length can't be taken for one another
    values = " ".join(f'{k}="{v}"' for k, v in zip("abcd", numbers, strict=True))
    geometry = words.at(5.0, -3.0, 0.7, length, f"<poly3 {values}/>")
    made.road("p", length, geometry=geometry)
    check_fit(only(load_library(made.write()), "road p forward").line, turned(places))


def check_fit(line: ReferenceLine, places: FloatArray) -> None:
    assert len(line.pieces) > 1
    assert np.abs(line.to_local_many(places[::60])[:, 1]).max() <= 0.01
    end = line.pose(line.length_m)
    assert (end.x_m, end.y_m) == pytest.approx(tuple(places[-1]), abs=0.01)


@pytest.mark.parametrize("span", ["arcLength", "normalized"])
def test_a_param_poly3_is_fitted_within_a_centimetre(made: Made, words: Words, span: str) -> None:
    p = np.linspace(0.0, 1.0, 60001)
    u, v = 58.0 * p + 1.0 * p**2 - 2.0 * p**3, 20.0 * p**2 - 15.0 * p**3
    places = np.stack([u, v], axis=1)
    length = length_of(places)
    scale = length if span == "arcLength" else 1.0
    numbers = {"bU": 58.0, "cU": 1.0, "dU": -2.0, "aU": 0.0, "aV": 0.0, "bV": 0.0}
    numbers |= {"cV": 20.0, "dV": -15.0}
    values = " ".join(f'{k}="{v / scale ** "abcd".index(k[0])}"' for k, v in numbers.items())
    shape = f'<paramPoly3 pRange="{span}" {values}/>'
    made.road("p", length, geometry=words.at(5.0, -3.0, 0.7, length, shape))
    check_fit(only(load_library(made.write()), "road p forward").line, turned(places))


@pytest.mark.parametrize(
    ("numbers", "why"),
    [
        ((0.0, 0.0, 0.0, 5e4), "runs off"),
        # A loop that is drawn at a speed which changes its sign.
        ((0.0, -30.0, 0.0, 60.0), "can't be fitted within 0.01 m"),
        ((0.0, 2.0, 0.0, 0.0), "is 56.57 m long, and is said to be 20 m"),
    ],
)
def test_a_cubic_that_cant_be_fitted(
    made: Made, words: Words, numbers: tuple[float, ...], why: str
) -> None:
    values = " ".join(
        f'{k}{side}="{v}"' for side in "UV" for k, v in zip("abcd", numbers, strict=True)
    )
    shape = f'<paramPoly3 pRange="arcLength" {values}/>'
    library = load_library(made.road(length=20.0, geometry=words.at(0, 0, 0, 20.0, shape)).write())
    assert library.blocks == ()
    assert why in library.rejected[0][1]


def test_a_cubic_that_stands_still(made: Made, words: Words) -> None:
    zeros = " ".join(f'{k}{side}="0"' for side in "UV" for k in "abcd")
    shape = f'<paramPoly3 pRange="arcLength" {zeros}/>'
    library = load_library(made.road(length=20.0, geometry=words.at(0, 0, 0, 20.0, shape)).write())
    assert "stands still" in library.rejected[0][1]


def test_small_kinks_are_led_over_and_large_ones_refused(made: Made, words: Words) -> None:
    def kinked(turn: float, gap: float) -> Library:
        made.parts.clear()
        geometry = words.at(0, 0, 0, 50) + words.at(50, gap, turn, 50, s=50)
        return load_library(made.road(geometry=geometry).write())

    bent = only(kinked(0.02, 0.005), "road 1 forward").line
    for s in (10.0, 49.0, 51.0, 60.0, 95.0):
        true = (s, 0.0) if s <= 50 else (50 + (s - 50) * math.cos(0.02), 0.005)
        if s > 50:
            true = (true[0], 0.005 + (s - 50) * math.sin(0.02))
        assert abs(bent.to_local(*true)[1]) <= 0.01
    # Seen over the length of a car it hardly bends.
    assert only(kinked(0.005, 0.0), "road 1 forward").segment == "straight"
    assert "degrees at s = 50 m without a curve" in kinked(0.2, 0.0).rejected[0][1]
    assert "0.300 m beside the end before it" in kinked(0.0, 0.3).rejected[0][1]


def test_a_length_that_the_geometry_hasnt(made: Made, words: Words) -> None:
    library = load_library(made.road(length=200.0, geometry=words.at(0, 0, 0, 100)).write())
    assert "says that it is 200 m long; its geometry has 100 m" in library.rejected[0][1]


def test_lanes_beyond_the_centre_of_curvature_have_no_coordinates(made: Made, words: Words) -> None:
    geometry = words.at(0, 0, 0, 10, '<arc curvature="0.3"/>')
    library = load_library(made.road(length=10.0, geometry=geometry).write())
    assert library.blocks == ()
    assert "3.5 m from the reference line on the inner side of a bend of 3.3 m" in str(
        library.rejected
    )


FULL_CIRCLE = '<arc curvature="0.08"/>'


def test_a_way_in_a_junction_that_comes_back_beside_itself_is_refused(
    made: Made, words: Words
) -> None:
    """Its places have two arc lengths each, which ended `ssp maps` in a traceback."""
    circle = words.at(0, 0, 0, 78.54, FULL_CIRCLE)
    made.road("sw", 78.54, geometry=circle, junction="9")
    made.road("we", 20.0, geometry=words.at(0, 40, 0, 20), junction="9")
    library = load_library(made.add('<junction id="9"/>').write())
    assert sorted(blocks(library)) == ["road we backward", "road we forward"]
    ((name, why),) = library.rejected
    assert name == "road sw"
    assert why.startswith("turns by 360 degrees, and of its line, offset 0 m at arc length 0 m has")


def test_a_route_over_a_road_that_comes_back_beside_itself_is_refused(
    words: Words, crossroads: Path
) -> None:
    text = crossroads.read_text()
    head, _, tail = text.partition('<road id="n" length="60.0"')
    shape, _, rest = tail.partition("</planView>")
    circle = words.at(0, 10, math.pi / 2, 78.54, FULL_CIRCLE)
    shape = shape.partition("<planView>")[0] + f"<planView>{circle}"
    crossroads.write_text(f'{head}<road id="n" length="78.54"{shape}</planView>{rest}')
    found, refused = routes_of(load_library(crossroads))
    assert {one.exits for one in found} == {("road e forward",), ("road w forward",)}
    ((name, why),) = refused
    assert name == "road sn forward"
    assert "none of its lanes continues one" in why


def test_straight_parts_of_bent_roads_are_blocks_too(made: Made, words: Words) -> None:
    made.road("x", 120.0, geometry=words.at(0, 0, 0, 120))
    line = only(load_library(made.write()), "road x forward").line
    made.parts.clear()
    arc_end = (120 + 50 * math.sin(0.8), 50 * (1 - math.cos(0.8)))
    geometry = (
        words.at(0, 0, 0, 120)
        + words.at(120, 0, 0, 40, '<arc curvature="0.02"/>', 120)
        + words.at(*arc_end, 0.8, 30, s=160)
    )
    library = load_library(made.road("x", 190.0, geometry=geometry).write())
    whole = only(library, "road x forward")
    assert whole.segment == "curve"
    (name,) = [n for n in blocks(library) if n.startswith("road x forward [")]
    part = only(library, name)
    assert part.segment == "straight"
    assert 110.0 <= part.length_m <= 120.0
    assert part.exits == ("road x forward",)
    assert part.line.pose(50.0) == line.pose(50.0)
    back = next(b for n, b in blocks(library).items() if n.startswith("road x backward ["))
    assert back.length_m == pytest.approx(part.length_m, abs=2.0)
    assert back.entrances == ("road x backward",)
