"""The ground that an event is compiled for, a site or a map, with what is allowed there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from ssp_core.geometry import point_in_polygon
from ssp_core.run_file.model import Camera, Limits, LinkDisturbance, Look
from ssp_core.run_file.participants import TrafficSpec
from ssp_core.run_file.values import Point
from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.compile.task import PlaceLink
from ssp_scenario_manager.interactions.base import CannotPlace
from ssp_scenario_manager.interactions.choosing import in_si
from ssp_scenario_manager.interactions.on_block import left_kerb_m, right_kerb_m
from ssp_scenario_manager.site import Region, Site
from ssp_scenario_manager.spec.model import Event, Interval
from ssp_scenario_manager.topology.block import Block, Library
from ssp_scenario_manager.topology.site_blocks import region_polygon

# A map says nothing about a fence: it is drawn this far beyond sidewalks and road.
FENCE_MARGIN_M = 3.0
# Nor about limits where K* leaves a side open.
DEFAULT_SPEED_MPS = 16.0
DEFAULT_ACCELERATION_MPS2 = 5.0


@dataclass(frozen=True)
class Ground:
    """A site or a map, read.

    Args:
        link: its kind, name and hash.
        library: its blocks.
        site: None for a map.
        map_data: the map's bytes; None for a site.
        map_name: file name of the map, empty for a site.
    """

    link: PlaceLink
    library: Library
    site: Site | None = None
    map_data: bytes | None = None
    map_name: str = ""

    @property
    def name(self) -> str:
        """For people: the site's name, or the map's file name."""
        return self.site.name if self.site is not None else self.map_name

    def limits(self, event: Event) -> Limits:
        """Ω_safe: what the place allows, cut down to what K* allows (METHOD 2.3)."""
        safety = event.constraints.safety
        speed, acceleration = in_si(safety.speed).max, in_si(safety.acceleration).max
        separation, duration = in_si(safety.separation).min, in_si(safety.duration).max
        place = self.site.limits if self.site is not None else None
        if place is None:
            place = Limits(speed_mps=DEFAULT_SPEED_MPS, acceleration_mps2=DEFAULT_ACCELERATION_MPS2)
        return place.model_copy(
            update={
                "speed_mps": _least(place.speed_mps, speed),
                "acceleration_mps2": _least(place.acceleration_mps2, acceleration),
                "separation_m": max(place.separation_m, separation or 0.0),
                "duration_s": _least(place.duration_s, duration),
            }
        )

    def camera(self, event: Event) -> Camera:
        """The site's camera, or for a map the usual one moved into what K* needs.

        Raises:
            CannotPlace: the site's camera doesn't deliver what K* needs.
        """
        need = event.constraints.camera
        hfov = in_si(need.hfov)
        if self.site is None:
            usual = Camera()
            return usual.model_copy(
                update={
                    "hfov_deg": _moved(usual.hfov_deg, _in_degrees(hfov)),
                    "width_px": round(_moved(usual.width_px, in_si(need.width))),
                    "rate_hz": _moved(usual.rate_hz, in_si(need.rate)),
                }
            )
        camera = self.site.camera
        for name, value, interval, unit in (
            ("hfov_deg", camera.hfov_deg, _in_degrees(hfov), "deg"),
            ("width_px", camera.width_px, in_si(need.width), "px"),
            ("rate_hz", camera.rate_hz, in_si(need.rate), "Hz"),
        ):
            if _moved(value, interval) != value:
                raise CannotPlace(
                    f"the site's camera.{name} is {value:g} {unit}, K* needs {interval.min} to "
                    f"{interval.max}"
                )
        return camera

    @property
    def look(self) -> Look:
        return self.site.look if self.site is not None else Look()

    @property
    def disturbance(self) -> LinkDisturbance:
        return self.site.disturbance if self.site is not None else LinkDisturbance()

    def traffic(self, block: Block) -> list[TrafficSpec]:
        """Surroundings of a block of the site; their lanes are those of the site's file."""
        if self.site is None:
            return []
        return next((list(b.traffic) for b in self.site.blocks if b.id == block.block_id), [])

    def geofence(self, block: Block) -> list[Point]:
        """The site's fence; for a map, one around the block and its sidewalks."""
        if self.site is not None:
            return region_polygon(self.site, self.site.geofence, "geofence")
        right = right_kerb_m(block) - block.sidewalk_right_m - FENCE_MARGIN_M
        left = left_kerb_m(block) + block.sidewalk_left_m + FENCE_MARGIN_M
        return strip_polygon(block.line, 0.0, block.length_m, right, left)

    def ot_reachable(self) -> list[list[Point]]:
        """Regions in which an OT can be; empty for a map."""
        return self._polygons("ot_reachable")

    def safe_stop_zones(self) -> list[list[Point]]:
        """Regions in which a run may end in a hurry; empty for a map."""
        return self._polygons("safe_stop_zones")

    def _polygons(self, name: Literal["ot_reachable", "safe_stop_zones"]) -> list[list[Point]]:
        if self.site is None:
            return []
        regions: list[Region] = getattr(self.site, name)
        return [
            region_polygon(self.site, region, f"{name}[{i}]") for i, region in enumerate(regions)
        ]


def strip_polygon(
    line: ReferenceLine, from_s_m: float, to_s_m: float, right_m: float, left_m: float
) -> list[Point]:
    """Outline of what lies between two arc lengths and two offsets, counter-clockwise."""
    low, high = sorted((from_s_m, to_s_m))
    right, left = sorted((right_m, left_m))
    return [*line.path(low, high, right), *line.path(high, low, left)]


def outside(points: Sequence[Point], polygons: Sequence[Sequence[Point]]) -> Point | None:
    """The first point that lies in none of the polygons; None when all lie in one."""
    for x, y in points:
        if not any(point_in_polygon(x, y, polygon) for polygon in polygons):
            return x, y
    return None


def _least(value: float, other: float | None) -> float:
    return value if other is None else min(value, other)


def _moved(value: float, interval: Interval) -> float:
    low = interval.min if interval.min is not None else value
    high = interval.max if interval.max is not None else value
    return min(max(value, low), high)


def _in_degrees(interval: Interval) -> Interval:
    """An angle in degrees, rounded past what the way through radians leaves."""

    def degrees(value: float | None) -> float | None:
        return None if value is None else round(value * 57.29577951308232, 9)

    if interval.unit != "rad":
        return interval
    return Interval(min=degrees(interval.min), max=degrees(interval.max), unit="deg")
