"""Mutated and truncated maps: blocks, or an InputError, and nothing else."""

from __future__ import annotations

import math
import re
import time
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import defusedxml.ElementTree as safe_xml
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ssp_core.errors import InputError
from ssp_scenario_manager.maps.load import load_library
from ssp_scenario_manager.maps.routes import with_routes

SHAPES = (
    "<line/>",
    '<arc curvature="0.01"/>',
    '<spiral curvStart="0.01" curvEnd="0"/>',
    '<paramPoly3 pRange="arcLength" aU="0" bU="1" cU="0" dU="0" aV="0" bV="0" cV="0.001" dV="0"/>',
    '<poly3 a="0" b="0" c="0.001" d="0"/>',
)
BESIDE = (
    '<objects><object type="crosswalk" s="9" t="0"/><object type="building" s="20" t="-14" '
    'hdg="0.1" length="9" width="8" height="6"/><object type="tree" s="0" t="9">'
    '<repeat s="0" length="30" distance="10" tStart="9" tEnd="9"/></object></objects>'
    '<signals><signal s="30" t="-8" orientation="+" type="274" value="50" unit="km/h"/></signals>'
)
XODR = (
    "<OpenDRIVE>"
    + "".join(
        f'<road id="{i}" length="50" junction="{-1 if i < 4 else 7}"><link>'
        f'<predecessor elementType="road" elementId="{(i + 4) % 5}" contactPoint="end"/>'
        f'<successor elementType="{"junction" if i == 3 else "road"}" elementId="{i + 1}" '
        'contactPoint="start"/></link>'
        '<type s="0" type="town"><speed max="50" unit="km/h"/></type>'
        f'<planView><geometry s="0" x="{i * 50}" y="0" hdg="0" length="50">{shape}</geometry>'
        "</planView>"
        '<lanes><laneOffset s="0" a="0.1" b="0" c="0" d="0"/><laneSection s="0">'
        '<left><lane id="1" type="driving"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane>'
        '</left><center><lane id="0" type="none"/></center>'
        '<right><lane id="-1" type="driving"><width sOffset="0" a="3.5" b="0" c="0" d="0"/>'
        '<roadMark sOffset="0" type="broken"/><speed sOffset="0" max="9"/></lane>'
        '<lane id="-2" type="sidewalk"><border sOffset="0" a="-6"/></lane></right>'
        "</laneSection></lanes>"
        f"{BESIDE if i in (0, 2) else ''}</road>"
        for i, shape in enumerate(SHAPES)
    )
    + '<junction id="7"><connection id="0" incomingRoad="3" connectingRoad="4" '
    'contactPoint="start"/></junction></OpenDRIVE>'
)
NET = (
    '<net><edge id=":B_0" function="internal"><lane id=":B_0_0" index="0" speed="8" '
    'shape="100,0 105,2 110,5"/></edge><edge id="ab" from="A" to="B"><lane id="ab_0" index="0" '
    'speed="13.9" shape="0,0 50,1 100,0"/><lane id="ab_1" index="1" speed="13.9" width="3" '
    'shape="0,3.2 50,4.2 100,3.2"/></edge><edge id="ba" from="B" to="A"><lane id="ba_0" index="0" '
    'speed="13.9" shape="100,6.4 50,7.4 0,6.4" allow="passenger bus"/></edge>'
    '<connection from="ab" to="ba" via=":B_0_0"/><connection from=":B_0" to="ba"/></net>'
)
LANE = '<center><lane id="0"/></center><right><lane id="-1" type="driving"><width a="3.5"/></lane>'


def road_in(name: str, x: int, y: int, yaw: float, length: int, junction: int, link: str) -> str:
    """A road of one lane of a crossroads."""
    return (
        f'<road id="{name}" length="{length}" junction="{junction}"><link>{link}</link><planView>'
        f'<geometry s="0" x="{x}" y="{y}" hdg="{yaw}" length="{length}"><line/></geometry>'
        f'</planView><lanes><laneSection s="0">{LANE}</right></laneSection></lanes></road>'
    )


def way_over(a: str, c: str, b: str, along: tuple[int, int], yaw: float) -> str:
    """A road to the junction, one over it, and one away from it."""
    (x, y), road = along, '<{} elementType="road" elementId="{}" contactPoint="{}"/>'
    to = '<successor elementType="junction" elementId="9"/>'
    ends = road.format("predecessor", a, "end") + road.format("successor", b, "start")
    return (
        road_in(a, -60 * x, -60 * y, yaw, 50, -1, to)
        + road_in(c, -10 * x, -10 * y, yaw, 20, 9, ends)
        + road_in(b, 10 * x, 10 * y, yaw, 50, -1, "")
    )


CROSSROADS = (
    "<OpenDRIVE>"
    + way_over("1", "2", "3", (1, 0), 0.0)
    + way_over("4", "5", "6", (0, 1), 1.5707963267948966)
    + '<junction id="9"><connection id="0" incomingRoad="1" connectingRoad="2" '
    'contactPoint="start"/><connection id="1" incomingRoad="4" connectingRoad="5" '
    'contactPoint="start"/></junction></OpenDRIVE>'
)
BASES = {"xodr": XODR, "net": NET, "crossroads": CROSSROADS}

# What a slip of the keyboard, a broken exporter or a joker would put there.
ODD = st.sampled_from(
    ["", "nan", "inf", "-1", "0", "1e308", "-1e9", "1e-300", "x", "١٢", "-0.0", "9" * 400, "3 4"]
) | st.text(max_size=6)


def loads_or_refuses(folder: Path, data: bytes) -> bool:
    """True when it loads; then every block has a finite line."""
    path = folder / "map.xml"
    path.write_bytes(data)
    try:
        library = with_routes(load_library(path))
    except InputError as error:
        if error.file != str(path):
            pytest.fail(f"the file isn't named: {error}")
        return False
    for block in library.blocks:
        end = block.line.pose(block.length_m)
        assert math.isfinite(end.x_m + end.y_m)
        assert block.forward_lanes
        assert all(0.0 < lane.width_m < 1000.0 for lane in block.lanes)
        for area in block.conflict_areas:
            assert 0.0 <= area.start_s_m < area.end_s_m <= block.length_m + 1e-6
        for other in (*block.entrances, *block.exits):
            assert any(b.block_id == other for b in library.drivable)
        for one in () if block.passage is None else block.passage.conflicts:
            assert 0.0 <= one.start_s_m <= one.s_m <= one.end_s_m <= block.length_m + 1e-6
    return True


@pytest.mark.parametrize("base", sorted(BASES))
def test_the_maps_themselves_load(tmp_path: Path, base: str) -> None:
    assert loads_or_refuses(tmp_path, BASES[base].encode())


def test_the_crossroads_has_routes_that_conflict(tmp_path: Path) -> None:
    path = tmp_path / "map.xml"
    path.write_text(CROSSROADS)
    found = [b.passage for b in with_routes(load_library(path)).blocks if b.passage is not None]
    assert [len(passage.conflicts) for passage in found] == [1, 1]


quick = settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


@pytest.mark.parametrize("base", sorted(BASES))
@quick
@given(data=st.data())
def test_truncated_maps(tmp_path: Path, base: str, data: st.DataObject) -> None:
    whole = BASES[base].encode()
    cut = data.draw(st.integers(0, len(whole) - 1))
    assert not loads_or_refuses(tmp_path, whole[:cut])


@pytest.mark.parametrize("base", sorted(BASES))
@quick
@given(data=st.data())
def test_mutated_bytes(tmp_path: Path, base: str, data: st.DataObject) -> None:
    whole = bytearray(BASES[base].encode())
    edits = data.draw(
        st.lists(
            st.tuples(st.integers(0, len(whole) - 1), st.binary(max_size=3), st.integers(0, 8)),
            min_size=1,
            max_size=4,
        )
    )
    for place, new, length in edits:
        whole[place : place + length] = new
    loads_or_refuses(tmp_path, bytes(whole))


@pytest.mark.parametrize("base", sorted(BASES))
@settings(parent=quick, max_examples=120)
@given(data=st.data())
def test_odd_values_in_attributes(tmp_path: Path, base: str, data: st.DataObject) -> None:
    pieces = re.split(r'("[^"<>]*")', BASES[base])
    values = [i for i, piece in enumerate(pieces) if piece.startswith('"')]
    for _ in range(data.draw(st.integers(1, 3))):
        pieces[data.draw(st.sampled_from(values))] = quoteattr(data.draw(ODD))
    loads_or_refuses(tmp_path, "".join(pieces).encode("utf-8", "replace"))


@pytest.mark.parametrize("base", sorted(BASES))
@quick
@given(data=st.data())
def test_elements_dropped_doubled_and_moved(tmp_path: Path, base: str, data: st.DataObject) -> None:
    root: Any = safe_xml.fromstring(BASES[base])
    for _ in range(data.draw(st.integers(1, 4))):
        parents = [element for element in root.iter() if len(element)]
        if not parents:
            break
        parent = data.draw(st.sampled_from(parents))
        child = parent[data.draw(st.integers(0, len(parent) - 1))]
        what = data.draw(st.sampled_from(["drop", "double", "move"]))
        if what != "double":
            parent.remove(child)
        if what != "drop":
            others = [e for e in root.iter() if e not in set(child.iter())]
            (
                parent if what == "double" or not others else data.draw(st.sampled_from(others))
            ).append(child)
    loads_or_refuses(tmp_path, safe_xml.tostring(root))


def test_a_huge_attribute_is_read_once(tmp_path: Path) -> None:
    file = tmp_path / "huge.xodr"
    file.write_text('<OpenDRIVE><road id="' + "x" * 30_000_000 + '"/></OpenDRIVE>')
    began = time.process_time()
    with pytest.raises(InputError, match="length"):
        load_library(file)
    assert time.process_time() - began < 8.0
