"""Maps for the topology tests, written element by element."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pytest

LINE = '<geometry s="0" x="0" y="0" hdg="0" length="{length}"><line/></geometry>'


def lane(
    lane_id: int,
    width: str | float = 3.5,
    kind: str = "driving",
    inner: str = "",
    mark: str = '<roadMark sOffset="0" type="broken"/>',
    attributes: str = "",
) -> str:
    """One lane; width may be elements of its own."""
    text = width if isinstance(width, str) else f'<width sOffset="0" a="{width}"/>'
    return f'<lane id="{lane_id}" type="{kind}" {attributes}>{inner}{text}{mark}</lane>'


def section(left: str = "", right: str = "", s: float = 0.0, centre: str = "") -> str:
    """One lane section, lanes from the left border to the right one."""
    middle = f'<center><lane id="0" type="none">{centre}</lane></center>'
    return (
        f'<laneSection s="{s}">'
        + (f"<left>{left}</left>" if left else "")
        + middle
        + (f"<right>{right}</right>" if right else "")
        + "</laneSection>"
    )


TWO_WAY = section(lane(1), lane(-1))
FOUR_LANES = section(lane(2) + lane(1), lane(-1) + lane(-2))


@dataclass
class MapText:
    """An OpenDRIVE map as text."""

    folder: Path
    parts: list[str] = field(default_factory=list)

    def road(
        self,
        road_id: str = "1",
        length: float = 100.0,
        *,
        geometry: str = LINE,
        sections: str = TWO_WAY,
        links: str = "",
        head: str = "",
        offsets: str = "",
        objects: str = "",
        junction: str = "-1",
        attributes: str = "",
    ) -> MapText:
        self.parts.append(
            f'<road id="{road_id}" length="{length}" junction="{junction}" {attributes}>'
            f"<link>{links}</link>{head}<planView>{geometry.format(length=length)}</planView>"
            f"<lanes>{offsets}{sections}</lanes><objects>{objects}</objects></road>"
        )
        return self

    def add(self, text: str) -> MapText:
        self.parts.append(text)
        return self

    def write(self, name: str = "map.xodr") -> Path:
        path = self.folder / name
        path.write_text(
            '<?xml version="1.0"?><OpenDRIVE><header revMajor="1" revMinor="7"/>'
            + "".join(self.parts)
            + "</OpenDRIVE>"
        )
        return path


def at(x: float, y: float, hdg: float, length: float, shape: str = "<line/>", s: float = 0) -> str:
    """A part of a plan view."""
    return f'<geometry s="{s}" x="{x}" y="{y}" hdg="{hdg}" length="{length}">{shape}</geometry>'


def to_road(tag: str, road_id: str, contact: str) -> str:
    """A link to a road."""
    return f'<{tag} elementType="road" elementId="{road_id}" contactPoint="{contact}"/>'


def to_junction(tag: str, junction_id: str) -> str:
    """A link to a junction."""
    return f'<{tag} elementType="junction" elementId="{junction_id}"/>'


@dataclass(frozen=True)
class Words:
    """The functions above, for tests that can't import a conftest."""

    lane: Callable[..., str] = lane
    section: Callable[..., str] = section
    at: Callable[..., str] = at
    to_road: Callable[[str, str, str], str] = to_road
    to_junction: Callable[[str, str], str] = to_junction
    two_way: str = TWO_WAY
    four_lanes: str = FOUR_LANES


@pytest.fixture
def words() -> Words:
    """Builders of map elements."""
    return Words()


@pytest.fixture
def made(tmp_path: Path) -> MapText:
    """An empty map, to be filled by the test."""
    return MapText(tmp_path)


@pytest.fixture
def crossroads(made: MapText, words: Words) -> Path:
    """Four arms of 60 m around a junction of 20 m; ways straight on, and one to the left."""
    half = 10.0
    lane_only = words.section("", words.lane(-1))
    for i, name in enumerate("nwse"):
        yaw = math.pi / 2 * (i + 1)
        x, y = half * math.cos(yaw), half * math.sin(yaw)
        made.road(
            name,
            60.0,
            geometry=words.at(x, y, yaw, 60),
            links=words.to_junction("predecessor", "9"),
        )
    # Straight from south to north, from west to east, from south to west.
    made.road(
        "sn",
        20.0,
        geometry=words.at(0, -half, math.pi / 2, 20),
        sections=lane_only,
        junction="9",
        links=words.to_road("predecessor", "s", "start") + words.to_road("successor", "n", "start"),
    )
    made.road(
        "we",
        20.0,
        geometry=words.at(-half, 0, 0, 20),
        sections=lane_only,
        junction="9",
        links=words.to_road("predecessor", "w", "start") + words.to_road("successor", "e", "start"),
    )
    made.road(
        "sw",
        math.pi / 2 * half,
        geometry=words.at(0, -half, math.pi / 2, math.pi / 2 * half, '<arc curvature="0.1"/>'),
        sections=lane_only,
        junction="9",
        links=words.to_road("predecessor", "s", "start") + words.to_road("successor", "w", "start"),
    )
    made.add(
        '<junction id="9">'
        + "".join(
            f'<connection id="{i}" incomingRoad="{a}" connectingRoad="{c}" contactPoint="start">'
            '<laneLink from="1" to="-1"/></connection>'
            for i, (a, c) in enumerate((("s", "sn"), ("w", "we"), ("s", "sw")))
        )
        + "</junction>"
    )
    return made.write()
