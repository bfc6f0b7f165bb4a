"""The parts of every export: its origin, its trigger, and the map with the ground's height."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from pathlib import PurePath

import numpy as np

from ssp_core.errors import InputError
from ssp_core.geometry import FloatArray, Pose2
from ssp_core.run_file.participants import RelativeDistance, TimeToArrival, TriggerSpec
from ssp_core.run_file.values import Point
from ssp_core.world.reference_line import NotOneToOne
from ssp_scenario_manager.compile.targets.opendrive import opendrive_map
from ssp_scenario_manager.compile.task import Task
from ssp_scenario_manager.maps.block import Block
from ssp_scenario_manager.maps.opendrive_road import Cubic, RoadRecord, elevations, read_road
from ssp_scenario_manager.maps.reference_line import Unusable, road_line
from ssp_scenario_manager.maps.xml_input import BadElement, document

# Reference lines are sampled this densely; a place this far from all of them has no height.
_SAMPLE_M = 2.0
_FARTHEST_M = 40.0


# A sample of a road that heads elsewhere belongs to another level of it, as on a spiral ramp.
_SAME_WAY = 0.5


class Heights:
    """Heights over a map's roads; all 0 where the map is flat.

    A place beside the block has the height of the block's own roads, whatever road lies nearer: a
    frontage road, or one over a bridge. Beyond the ends of its roads, and far from them, as across
    a ring, the nearest road counts.

    Args:
        xodr: text of an OpenDRIVE map; None: flat.
        block: None: the nearest road counts everywhere.

    Raises:
        InputError: it isn't XML, or a road in it can't be read.
    """

    def __init__(self, xodr: str | None, block: Block | None = None) -> None:
        self._profiles: list[list[Cubic]] = []
        self._samples: FloatArray = np.empty((0, 6))
        self._own: FloatArray = np.empty((0, 6))
        self._block = block
        if xodr is None:
            return
        root = document(xodr.encode())
        try:
            roads = list(root.iter("road"))
            self._profiles = [elevations(road) for road in roads]
            if self.is_flat:
                return
            rows = [_samples(i, read_road(road)) for i, road in enumerate(roads)]
        except BadElement as error:
            raise InputError(
                f"its <{error.element.tag}> {error.problem}", remedy="mend the map, or give another"
            ) from error
        self._samples = np.concatenate(rows)
        if block is not None:
            mine = [i for i, road in enumerate(roads) if road.get("id") in block.roads]
            self._own = self._samples[np.isin(self._samples[:, 2], mine)]

    @property
    def is_flat(self) -> bool:
        """Tell whether no road rises or lies above or below 0."""
        return not any(c.a or not c.is_constant for profile in self._profiles for c in profile)

    def at(self, place: Point) -> float:
        """Return the height of the ground, m.

        Raises:
            InputError: the place is far from all roads of a map that isn't flat.
        """
        if not len(self._samples):
            return 0.0
        sample = self._own_sample(place)
        if sample is None:
            sample = _nearest(self._samples, place)
        x, y, index, s, _, _ = map(float, sample)
        apart = math.hypot(x - place[0], y - place[1])
        if apart > _FARTHEST_M:
            raise InputError(
                f"is {apart:.0f} m from the nearest road, so that its height is unknown",
                value=place,
                remedy="place it on or beside a road of the map",
            )
        reached = [cubic for cubic in self._profiles[int(index)] if cubic.s_m <= s]
        return reached[-1].at(s) if reached else 0.0

    def _own_sample(self, place: Point) -> FloatArray | None:
        """Return the sample of the block's roads beside a place, None beyond or far from them."""
        own = self._own
        if self._block is None or not len(own):
            return None
        line = self._block.line
        with suppress(NotOneToOne):
            station = line.to_local(*place)[0]
            yaw = line.pose(min(max(station, 0.0), line.length_m)).yaw_rad
            own = own[np.abs(np.sin(own[:, 4] - yaw)) < _SAME_WAY]
        if not len(own):
            return None
        sample = _nearest(own, place)
        if math.hypot(sample[0] - place[0], sample[1] - place[1]) > _FARTHEST_M:
            return None
        ahead = Pose2(sample[0], sample[1], sample[4]).to_local(*place)[0]
        return None if sample[5] * ahead > _SAMPLE_M else sample


def _nearest(samples: FloatArray, place: Point) -> FloatArray:
    apart = np.hypot(samples[:, 0] - place[0], samples[:, 1] - place[1])
    sample: FloatArray = samples[int(np.argmin(apart))]
    return sample


def _samples(index: int, road: RoadRecord) -> FloatArray:
    """Sample a road as (x, y, index, s, heading, end), none if it isn't any block's.

    ``end`` is -1 at the road's start, 1 at its end, and 0 between them.
    """
    try:
        line = road_line(road)
    except Unusable:
        return np.empty((0, 6))
    s = np.linspace(0.0, line.length_m, math.ceil(line.length_m / _SAMPLE_M) + 1)
    ends = np.zeros_like(s)
    ends[0], ends[-1] = -1.0, 1.0
    yaws = np.array([pose.yaw_rad for pose in line.poses(s.tolist())])
    return np.column_stack([line.to_map_many(s, 0.0), np.full_like(s, index), s, yaws, ends])


@dataclass(frozen=True, slots=True)
class MapFile:
    """The OpenDRIVE map of an export.

    Args:
        own: made from the block; else the user's map as it is.
    """

    name: str
    data: bytes
    own: bool
    heights: Heights


def provenance(task: Task) -> dict[str, str]:
    """Give the provenance that every file of an export states (METHOD 2.5)."""
    return {
        "event": task.event.name,
        "event_version": task.event.version,
        "task_version": task.version,
        "compiler": task.compiler,
        "seed": str(task.seed),
    }


def trigger_condition(spec: TriggerSpec) -> RelativeDistance | TimeToArrival:
    """Return a compiled task's trigger condition: a distance or an arrival, without an edge."""
    plain = spec.edge == "none" and spec.held_for_s == 0.0
    if not (plain and isinstance(spec.condition, RelativeDistance | TimeToArrival)):
        raise ValueError(f"{spec.id} asks what no compiled trigger does: {spec.condition.type}")
    return spec.condition


def map_file(task: Task, block: Block, map_text: str | None) -> MapFile:
    """Return the user's OpenDRIVE map, or else one of the block (of a site or a SUMO network).

    Raises:
        InputError: the block can't be put into OpenDRIVE, or the map's text is missing.
    """
    if task.place.kind == "opendrive":
        if map_text is None:
            raise InputError(
                "needs the map that it was compiled for",
                field="place.name",
                remedy="give the map with --map",
            )
        name = PurePath(task.place.name).name
        return MapFile(name, map_text.encode(), own=False, heights=Heights(map_text, block))
    name = PurePath(task.place.name).name.split(".")[0]
    data = opendrive_map(block, name, provenance(task), task.run.road.junction)
    return MapFile(f"{name}.xodr", data, own=True, heights=Heights(None))
