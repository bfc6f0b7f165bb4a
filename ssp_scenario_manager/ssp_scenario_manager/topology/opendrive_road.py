"""One road and one junction of an OpenDRIVE map, as they stand in the file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ssp_core.run_file.road import SceneryItem

End = Literal["start", "end"]


@dataclass(frozen=True, slots=True)
class Geometry:
    """A part of the reference line.

    Args:
        s_m: where it starts along the road.
        x_m: its start, as y_m and heading.
        y_m: as x_m.
        heading_rad: there.
        length_m: of the part.
        kind: how it is described.
        numbers: curvature; start and end curvature; a to d; aU to dU and aV to dV.
        normalised: paramPoly3 whose parameter runs from 0 to 1.
    """

    s_m: float
    x_m: float
    y_m: float
    heading_rad: float
    length_m: float
    kind: Literal["line", "arc", "spiral", "poly3", "paramPoly3"]
    numbers: tuple[float, ...] = ()
    normalised: bool = False


@dataclass(frozen=True, slots=True)
class Cubic:
    """a + b d + c d^2 + e d^3, with d the distance from s_m (along the road), m."""

    s_m: float
    a: float
    b: float
    c: float
    d: float

    def at(self, s_m: float) -> float:
        u = s_m - self.s_m
        return self.a + u * (self.b + u * (self.c + u * self.d))

    @property
    def is_constant(self) -> bool:
        return self.b == self.c == self.d == 0.0


@dataclass(frozen=True, slots=True)
class Mark:
    """The marking on a lane's outer border, from s_m (along the road) on."""

    s_m: float
    type: str
    lane_change: str | None


@dataclass(frozen=True, slots=True)
class LaneRecord:
    """A lane of one lane section; all s_m are along the road."""

    id: int
    type: str
    widths: tuple[Cubic, ...]
    borders: tuple[Cubic, ...]
    marks: tuple[Mark, ...]
    speeds: tuple[tuple[float, float | None], ...]
    reversed: bool


@dataclass(frozen=True, slots=True)
class Section:
    """A lane section: lanes from the left border to the right one, without lane 0."""

    start_m: float
    end_m: float
    lanes: tuple[LaneRecord, ...]
    centre_marks: tuple[Mark, ...]


@dataclass(frozen=True, slots=True)
class Link:
    """What a road's end is joined to."""

    kind: Literal["road", "junction"]
    id: str
    contact: End | None


@dataclass(frozen=True, slots=True)
class RoadRecord:
    """A road.

    Args:
        id: unique in the map.
        junction: whose connecting road it is, None outside of one.
        length_m: along its reference line.
        left_hand: traffic keeps to the left.
        links: what its start and end are joined to.
        types: (s, type, speed limit in m/s or None), in order.
        geometry: parts of the reference line, in order.
        offsets: of lane 0 from the reference line.
        sections: lane sections, in order.
        crosswalks_m: arc lengths of marked crossings.
        scenery: what stands beside it, along its reference line.
        not_drawn: how much more there is of it that can't be.
    """

    id: str
    junction: str | None
    length_m: float
    left_hand: bool
    links: dict[End, Link]
    types: tuple[tuple[float, str, float | None], ...]
    geometry: tuple[Geometry, ...]
    offsets: tuple[Cubic, ...]
    sections: tuple[Section, ...]
    crosswalks_m: tuple[float, ...]
    scenery: tuple[SceneryItem, ...] = ()
    not_drawn: int = 0


@dataclass(frozen=True, slots=True)
class Connection:
    """A way through a junction: the end of a road that enters, and the road that it leads to."""

    junction: str
    incoming: str
    to: str
    contact: End
