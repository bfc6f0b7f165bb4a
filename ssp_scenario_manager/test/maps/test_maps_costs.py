"""Large and hostile maps take processor time in proportion to their size.

The bounds are several times what is measured; each map took longer when everything in it was held
against everything else.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from ssp_scenario_manager.maps.block import Library
from ssp_scenario_manager.maps.load import load_library
from ssp_scenario_manager.maps.routes import MOST_ROUTES, with_routes

LANE = '<lane id="-1" type="driving">{}</lane>'
WIDTH = '<width sOffset="{}" a="{}" b="0" c="0" d="0"/>'
CAR_LANE = LANE.format(WIDTH.format(0, 3.5))


def section(lane: str, s_m: float = 0) -> str:
    return f'<laneSection s="{s_m}"><right>{lane}</right></laneSection>'


def road(
    name: object,
    x_m: float,
    length_m: float,
    *,
    links: str = "",
    sections: str = "",
    junction: str = "-1",
    beside: str = "",
) -> str:
    return (
        f'<road id="{name}" length="{length_m}" junction="{junction}"><link>{links}</link>'
        f'<planView><geometry s="0" x="{x_m}" y="0" hdg="0" length="{length_m}"><line/></geometry>'
        f"</planView><lanes>{sections or section(CAR_LANE)}</lanes>{beside}</road>"
    )


def follows(kind: str, name: object) -> str:
    place = ' contactPoint="start"' if kind == "road" else ""
    return f'<successor elementType="{kind}" elementId="{name}"{place}/>'


def roads_of_no_length() -> str:
    walk = section(CAR_LANE.replace("driving", "sidewalk"))
    return road("a", 0, 20, links=follows("road", 0)) + "".join(
        road(i, 20, 0.005, links=follows("road", i + 1) if i < 7999 else "", sections=walk)
        for i in range(8000)
    )


def widths_and_limits() -> str:
    widths = "".join(WIDTH.format(i / 10, 3.5 if i % 2 else 1.0) for i in range(12_000))
    limits = "".join(f'<speed sOffset="{i / 10}" max="10"/>' for i in range(12_000))
    return road("a", 0, 1200, sections=section(LANE.format(widths + limits)))


def sections_and_crosswalks() -> str:
    zebra = '<object type="crosswalk" id="{0}" s="{0}" t="0" hdg="0" length="3" width="8"/>'
    return road(
        "a",
        0,
        600,
        sections="".join(
            section(LANE.format(WIDTH.format(0, 3.5 if i % 2 else 3.0)), i) for i in range(600)
        ),
        beside="<objects>" + "".join(zebra.format(i) for i in range(600)) + "</objects>",
    )


@pytest.mark.parametrize("made", [roads_of_no_length, widths_and_limits, sections_and_crosswalks])
def test_parts_of_a_map_are_not_held_against_all_others(
    made: Callable[[], str], tmp_path: Path
) -> None:
    assert loaded(tmp_path / "large.xodr", f"<OpenDRIVE>{made()}</OpenDRIVE>", 8.0).blocks


def test_edges_that_all_lead_back_are_refused(tmp_path: Path) -> None:
    def edge(name: str, start: str, end: str, shape: str) -> str:
        lane = f'<lane id="{name}_0" index="0" speed="10" shape="{shape}"/>'
        return f'<edge id="{name}" from="{start}" to="{end}">{lane}</edge>'

    ways = (("f", "a", "b", "0,0 50,0"), ("b", "b", "a", "50,9 0,9"))
    net = "".join(edge(f"{name}{i}", *rest) for name, *rest in ways for i in range(1000))
    library = loaded(tmp_path / "back.net.xml", f"<net>{net}</net>", 4.0)
    assert not library.blocks
    assert dict(library.rejected)["edge f0"] == (
        "1000 edges lead back from its end to its start, and at most 64 are looked at"
    )


def test_a_joined_way_has_a_limited_number_of_pieces(tmp_path: Path) -> None:
    edges = "".join(
        f'<edge id="e{i}" from="n{i}" to="n{i + 1}"><lane id="e{i}_0" index="0" speed="10" '
        f'shape="{i / 20},0 {(i + 1) / 20},0"/></edge><connection from="e{i}" to="e{i + 1}"/>'
        for i in range(2001)
    )
    library = loaded(tmp_path / "short.net.xml", f"<net>{edges}</net>", 20.0)
    assert sorted(len(block.roads) for block in library.blocks) == [1, 2000]


@pytest.mark.parametrize(
    ("leads_out", "says"),
    [
        (True, f"has more than {MOST_ROUTES} routes, which aren't looked at"),
        (False, "more than 20000 ways over its roads would have to be looked at"),
    ],
)
def test_ways_that_part_and_meet_again_are_not_all_followed(
    leads_out: bool, says: str, tmp_path: Path
) -> None:
    count, depth = 16, 4  # 65,536 ways
    roads = road("in", -20, 20, links=follows("junction", "j")) + road("out", 20, 30)
    pairs = [("in", f"0_{i}") for i in range(count)]
    for k in range(depth):
        out = leads_out and k == depth - 1
        links = follows("road", "out") if out else follows("junction", "j")
        for i in range(count):
            roads += road(f"{k}_{i}", 5 * k, 5, links=links, junction="j")
            pairs += [(f"{k}_{i}", f"{k + 1}_{j}") for j in range(count) if k < depth - 1]
    connections = "".join(
        f'<connection incomingRoad="{a}" connectingRoad="{b}" contactPoint="start"/>'
        for a, b in pairs
    )
    text = f'<OpenDRIVE>{roads}<junction id="j">{connections}</junction></OpenDRIVE>'
    library = loaded(tmp_path / "fan.xodr", text, 4.0)
    began = time.process_time()
    assert ("junction j", says) in with_routes(library).rejected
    assert time.process_time() - began < 20.0


def loaded(file: Path, text: str, most_s: float) -> Library:
    file.write_text(text)
    began = time.process_time()
    library = load_library(file)
    assert time.process_time() - began < most_s
    return library
