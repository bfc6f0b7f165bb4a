"""``ssp.site/1``: a proving ground or simulated place, its blocks and regions (METHOD 2.1)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, SerializerFunctionWrapHandler, Tag, model_serializer

from ssp_core.errors import InputError
from ssp_core.files.reading import parse_model, read_mapping
from ssp_core.geometry import outline_problem
from ssp_core.hashing import sha256_json
from ssp_core.motion.state import DEFAULT_SIZES
from ssp_core.run_file.model import Camera, Limits, LinkDisturbance, Look
from ssp_core.run_file.participants import TrafficSpec
from ssp_core.run_file.road import CurvePiece, Lane, Scenery
from ssp_core.run_file.values import (
    Finite,
    ObjectId,
    Point,
    Positive,
    SiteDatum,
    Start,
    Strict,
    without_defaults,
)
from ssp_core.vocabulary import ObjectClass
from ssp_core.world.reference_line import NotOneToOne, ReferenceLine
from ssp_core.world.scenery import Clearance
from ssp_scenario_manager.maps.block import (
    Block,
    BlockLane,
    ConflictArea,
    Library,
    conflict_areas,
    segment_of,
)
from ssp_scenario_manager.maps.crossings import Crossing
from ssp_scenario_manager.maps.legs import LANES_MEET_M, lanes_apart_m
from ssp_scenario_manager.maps.way_blocks import junction_areas

LIBRARY = Path(__file__).resolve().parents[1] / "library"


class Strip(Strict):
    """A region in a block's frame: between two arc lengths and two offsets (+ left)."""

    block: ObjectId
    from_s_m: Finite
    to_s_m: Finite
    from_l_m: Finite
    to_l_m: Finite


class Polygon(Strict):
    """A region in frame map, as it was surveyed."""

    points: Annotated[list[Point], Field(min_length=3)]


def _kind_of_region(value: Any) -> str | None:
    """Tell which of both kinds is meant, so that errors name what is wrong with that one."""
    if isinstance(value, Strip | Polygon):
        return type(value).__name__
    if not isinstance(value, dict):
        return None
    if "points" in value:
        return "Polygon"
    return "Strip" if value.keys() & Strip.model_fields.keys() else None


Region = Annotated[
    Annotated[Strip, Tag("Strip")] | Annotated[Polygon, Tag("Polygon")],
    Discriminator(
        _kind_of_region,
        custom_error_type="region",
        custom_error_message="is no region: a polygon has points (at least 3, frame map), a strip "
        "has block, from_s_m, to_s_m, from_l_m and to_l_m",
    ),
]


# What a site may be; what is derived from these lies within the ranges of all files.
Width = Annotated[float, Field(gt=0, le=100)]
SidewalkWidth = Annotated[float, Field(ge=0, le=100)]
Northing = Annotated[float, Field(ge=-1e7, le=1e7)]


class SiteOrigin(Start):
    """The start of a site's reference line; UTM coordinates are within its range."""

    x_m: Northing
    y_m: Northing


class SitePiece(CurvePiece):
    """A piece of a site's reference line."""

    length_m: Annotated[float, Field(gt=0, le=20_000)]


class SiteLane(Lane):
    """A lane of a site's block."""

    y_m: Annotated[float, Field(ge=-1000, le=1000)] = Field(
        description="lateral position of the centre line"
    )
    width_m: Width


class SiteBlock(Strict):
    """One stretch of road of the site."""

    id: ObjectId
    origin: SiteOrigin = Field(description="pose of the reference line's start, frame map")
    pieces: Annotated[list[SitePiece], Field(min_length=1, max_length=1000)]
    lanes: Annotated[list[SiteLane], Field(min_length=1, max_length=64)]
    road_type: Literal["urban", "rural", "motorway", "proving_ground"]
    left_boundary: Literal["kerb", "sidewalk", "shoulder", "verge"]
    right_boundary: Literal["kerb", "sidewalk", "shoulder", "verge"]
    sidewalk_left_m: SidewalkWidth = 0.0
    sidewalk_right_m: SidewalkWidth = 0.0
    permitted: Annotated[
        list[Literal["keep_lane", "lane_change_left", "lane_change_right", "crossing", "stop"]],
        Field(min_length=1),
    ]
    leads_to: list[ObjectId] = []
    junction: ObjectId | None = Field(None, description="that it leads through")
    crossing_x_m: Finite | None = None
    speed_limit_mps: Positive
    traffic: list[TrafficSpec] = Field([], description="surroundings, for any event")
    scenery: Scenery = Field([], description="what stands beside the road, block frame")

    @model_serializer(mode="wrap")
    def _without_empty_scenery(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return without_defaults(dump(self), scenery=[], junction=None)


class Site(Strict):
    """A place: its blocks and the Physical library's regions (METHOD 2.1)."""

    schema_: Literal["ssp.site/1"] = Field(alias="schema")
    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,31}$")]
    description: str
    domain: Literal["simulation", "physical"]
    stand_in: bool
    blocks: Annotated[list[SiteBlock], Field(min_length=1)]
    ot_reachable: Annotated[list[Region], Field(min_length=1)]
    safe_stop_zones: Annotated[list[Region], Field(min_length=1)]
    geofence: Region
    limits: Limits
    camera: Camera = Camera()
    look: Look = Look()
    disturbance: LinkDisturbance = LinkDisturbance()
    datum: SiteDatum | None = Field(None, description="null: unknown; see docs/sites.md")

    @model_serializer(mode="wrap")
    def _without_unknown_datum(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return without_defaults(dump(self), datum=None)


def load_site(name_or_path: str) -> tuple[Site, str]:
    """Load a site by name or file; return it and its version, the hash of content, not of text.

    Raises:
        InputError: there is no such site, or the file is not valid; all that is wrong with it.
    """
    path = find_shipped(name_or_path, "site")
    site = parse_model(Site, read_mapping(path), path)
    return site, site_version(site)


def site_version(site: Site) -> str:
    """Return the content hash of a site."""
    return sha256_json(site.model_dump(mode="json", by_alias=True))


_FILES = (".yaml", ".yml", ".json", ".xodr", ".xml")


def find_shipped(name_or_path: str, kind: Literal["site", "event"]) -> Path:
    """Return the file itself, or the one of that name that comes with the project.

    A text written as a path is one, whether or not a file is there: its reader says what is wrong.

    Raises:
        InputError: it is neither a path nor a name.
    """
    path = Path(name_or_path)
    shipped = LIBRARY / f"{kind}s" / f"{name_or_path}.{kind}.yaml"
    with suppress(OSError):  # a name that is longer than any file's
        if path.suffix in _FILES or path.is_file():
            return path
        if shipped.is_file():
            return shipped
        # An empty name is that of the folder here.
        if path.name != name_or_path or (name_or_path and path.exists()):
            return path
    names = ", ".join(sorted(p.name.split(".")[0] for p in (LIBRARY / f"{kind}s").glob("*.yaml")))
    raise InputError(
        f"no such {kind}", value=name_or_path, remedy=f"name one of {names}, or give a file"
    )


_REGION_ERROR_M = 0.02
# Regions lie inside the fence to so much.
_INSIDE_M = 0.001


def site_line(block: SiteBlock, field: str) -> ReferenceLine:
    """Return the reference line of a site's block.

    Raises:
        InputError: the pieces make no line.
    """
    try:
        return ReferenceLine(block.origin.pose, block.pieces)
    except ValueError as error:
        raise InputError(
            f"make no road: {error}", field=f"{field}.pieces", remedy="shorten or straighten them"
        ) from error


def _check_lanes(block: SiteBlock, field: str) -> Iterator[InputError]:
    ordered = sorted(range(len(block.lanes)), key=lambda i: block.lanes[i].y_m)
    for low, high in pairwise(ordered):
        right, left = block.lanes[low], block.lanes[high]
        overlap = right.y_m + right.width_m / 2 - (left.y_m - left.width_m / 2)
        if overlap > 1e-6:
            yield InputError(
                f"overlaps lanes[{low}] by {overlap:g} m",
                field=f"{field}.lanes[{high}]",
                value=left.y_m,
                remedy=f"lane centres must be {(right.width_m + left.width_m) / 2:g} m apart",
            )
    if not any(lane.direction == "forward" for lane in block.lanes):
        yield InputError(
            "has no forward lane", field=f"{field}.lanes", remedy="the VUT drives in one"
        )


def _check_sides(block: SiteBlock, field: str) -> Iterator[InputError]:
    """Check that a side is called what SUMO and the camera make of it, by its sidewalk."""
    for side in ("left", "right"):
        boundary = getattr(block, f"{side}_boundary")
        name, width_m = f"sidewalk_{side}_m", getattr(block, f"sidewalk_{side}_m")
        if boundary in ("verge", "shoulder") and width_m > 0.0:
            yield InputError(
                f"has no sidewalk, and {name} draws one of {width_m:g} m",
                field=f"{field}.{side}_boundary",
                value=boundary,
                remedy=f"write sidewalk, or leave {name} out",
            )
        if boundary == "sidewalk" and width_m == 0.0:
            yield InputError(
                f"has no width: {name} is 0",
                field=f"{field}.{side}_boundary",
                value=boundary,
                remedy=f"give {name}, or write verge",
            )


def _check_traffic(
    site: Site, block: SiteBlock, line: ReferenceLine, field: str
) -> Iterator[InputError]:
    vehicle_ids: set[str] = set()
    for i, vehicle in enumerate(block.traffic):
        here = f"{field}.traffic[{i}]"
        if vehicle.id in vehicle_ids:
            yield InputError(
                "stands twice",
                field=f"{here}.id",
                value=vehicle.id,
                remedy="give each vehicle an id of its own",
            )
        vehicle_ids.add(vehicle.id)
        if vehicle.object_class == "pedestrian":
            yield InputError(
                "can't be traffic",
                field=f"{here}.object_class",
                value=vehicle.object_class,
                remedy="name a class of vehicle",
            )
        if vehicle.lane >= len(block.lanes):
            yield InputError(
                "there is no such lane",
                field=f"{here}.lane",
                value=vehicle.lane,
                remedy=f"the block has lanes 0 to {len(block.lanes) - 1}",
            )
            continue
        if not 0.0 <= vehicle.x_m <= line.length_m:
            yield InputError(
                "leaves the block",
                field=f"{here}.x_m",
                value=vehicle.x_m,
                remedy=f"0 to {line.length_m:g} m fits",
            )
        for limit, name in (
            (block.speed_limit_mps, f"{field}.speed_limit_mps, the posted speed"),
            (site.limits.speed_mps, "limits.speed_mps, the limit of everybody"),
        ):
            if vehicle.speed_mps > limit:
                yield InputError(
                    f"{vehicle.id} is faster than {name}",
                    field=f"{here}.speed_mps",
                    value=vehicle.speed_mps,
                    remedy=f"at most {limit:g} m/s",
                )
        for other in block.traffic[:i]:
            overlap = _overlap_m(block, vehicle, other)
            if overlap > 0.0:
                yield InputError(
                    f"{other.id} and {vehicle.id} overlap by {overlap:g} m",
                    field=f"{here}.x_m",
                    value=vehicle.x_m,
                    remedy="x_m is the front bumper; keep vehicles of one lane apart",
                )


def _overlap_m(block: SiteBlock, one: TrafficSpec, other: TrafficSpec) -> float:
    """Return the length that two vehicles of one lane share at the start, m; 0 in two lanes."""
    if one.lane != other.lane:
        return 0.0
    spans = []
    for vehicle in (one, other):
        length = DEFAULT_SIZES[ObjectClass.from_word(vehicle.object_class)].length_m
        behind = -length if block.lanes[vehicle.lane].direction == "forward" else length
        spans.append(sorted((vehicle.x_m, vehicle.x_m + behind)))
    (low, high), (first, last) = spans
    return round(max(0.0, min(high, last) - max(low, first)), 3)


def _check_scenery(block: SiteBlock, line: ReferenceLine, field: str) -> Iterator[InputError]:
    clearance = Clearance(line, [(lane.y_m, lane.width_m) for lane in block.lanes])
    for i, item in enumerate(block.scenery):
        problem = clearance.problem(item)
        if problem is not None:
            yield InputError(
                f"{problem} (a {item.type})",
                field=f"{field}.scenery[{i}]",
                value=f"s_m {item.s_m:g}, l_m {item.l_m:g}",
                remedy="give it a place beside the lanes",
            )


def _check_block(site: Site, index: int) -> Iterator[InputError]:
    block, field = site.blocks[index], f"blocks[{index}]"
    if block.id in (other.id for other in site.blocks[:index]):
        yield InputError(
            "stands twice",
            field=f"{field}.id",
            value=block.id,
            remedy="give each block an id of its own",
        )
    yield from _check_lanes(block, field)
    yield from _check_sides(block, field)
    block_ids = [other.id for other in site.blocks]
    for i, name in enumerate(block.leads_to):
        if name not in block_ids:
            yield InputError(
                "is no block of this site",
                field=f"{field}.leads_to[{i}]",
                value=name,
                remedy=f"its blocks are {', '.join(block_ids)}",
            )
    try:
        line = site_line(block, field)
    except InputError as error:
        yield error
        return
    yield from _check_traffic(site, block, line, field)
    yield from _check_scenery(block, line, field)
    yield from _check_ways_through(site, block, field)
    if block.crossing_x_m is not None and not 0.0 <= block.crossing_x_m <= line.length_m:
        yield InputError(
            "leaves the block",
            field=f"{field}.crossing_x_m",
            value=block.crossing_x_m,
            remedy=f"0 to {line.length_m:g} m fits",
        )


def _check_ways_through(site: Site, block: SiteBlock, field: str) -> Iterator[InputError]:
    """Check that the blocks of a junction are led to and lead on, lane to lane."""
    if block.junction is None:
        return
    if "crossing" in block.permitted:
        yield InputError(
            f"can't be crossed on foot: it is in junction {block.junction}",
            field=f"{field}.permitted",
            value="crossing",
            remedy="leave it out; give crossing to a block that leads to the junction",
        )
    before = [other for other in site.blocks if block.id in other.leads_to]
    if not before:
        yield InputError(
            f"is in junction {block.junction}, and no block leads to it",
            field=f"{field}.leads_to",
            value=block.id,
            remedy="name it in leads_to of the block that it continues",
        )
    after = [other for other in site.blocks if other.id in block.leads_to]
    if not after:
        yield InputError(
            f"leads out of junction {block.junction} to no block",
            field=f"{field}.leads_to",
            remedy="name the block that continues it",
        )
    for one, other in [(a, block) for a in before] + [(block, b) for b in after]:
        with suppress(InputError):  # a line that can't be made is an error of its own
            apart_m = lanes_apart_m(_unlinked(one, field), _unlinked(other, field))
            if apart_m > LANES_MEET_M:
                yield InputError(
                    f"no lane of {one.id} ends where one of {other.id} begins, in its direction: "
                    f"{apart_m:.2f} m apart",
                    field=f"{field}.origin",
                    remedy=f"move it, or its pieces, so that they meet to {LANES_MEET_M:g} m",
                )


def _unlinked(block: SiteBlock, field: str) -> Block:
    """Return a block of a site that knows nothing of the others.

    Raises:
        InputError: its pieces make no line.
    """
    line = site_line(block, field)
    site_lanes = (
        BlockLane(lane.y_m, lane.width_m, lane.direction == "forward", f"lanes[{i}]")
        for i, lane in enumerate(block.lanes)
    )
    lanes = tuple(sorted(site_lanes, key=lambda lane: lane.y_m))
    permitted = frozenset[str](block.permitted)
    marked = () if block.crossing_x_m is None else (block.crossing_x_m,)
    areas: tuple[ConflictArea, ...] = ()
    if block.junction is None:
        areas = conflict_areas(line.length_m, lanes, permitted, marked)
    return Block(
        block_id=block.id,
        line=line,
        lanes=lanes,
        road_type=block.road_type,
        segment=segment_of(line) if block.junction is None else "junction",
        left_boundary=block.left_boundary,
        right_boundary=block.right_boundary,
        sidewalk_left_m=block.sidewalk_left_m,
        sidewalk_right_m=block.sidewalk_right_m,
        permitted=permitted,
        conflict_areas=areas,
        crossings=tuple(map(Crossing, marked)),
        speed_limit_mps=block.speed_limit_mps,
        scenery=tuple(block.scenery),
        junction=block.junction,
    )


def _linked(site: Site) -> list[Block]:
    """Return the blocks of a site with what leads to what, and the conflicts in its junctions."""
    blocks = [
        replace(
            _unlinked(block, f"blocks[{i}]"),
            entrances=tuple(sorted(o.id for o in site.blocks if block.id in o.leads_to)),
            exits=tuple(sorted(set(block.leads_to))),
        )
        for i, block in enumerate(site.blocks)
    ]
    areas: dict[str, tuple[ConflictArea, ...]] = {}
    for junction in sorted({block.junction for block in blocks if block.junction is not None}):
        areas |= junction_areas([block for block in blocks if block.junction == junction])
    return [
        replace(block, conflict_areas=areas.get(block.block_id, block.conflict_areas))
        for block in blocks
    ]


def site_library(site: Site, file: str | Path | None = None) -> Library:
    """Return the blocks of a site, each in the direction that its file gives it.

    Raises:
        InputError: blocks or regions of the site contradict each other; every place where they do.
    """
    errors = list(_contradictions(site))
    if errors:
        raise InputError.of_all(errors, file)
    return Library(
        source=site.name,
        sha256=site_version(site),
        kind="site",
        blocks=tuple(sorted(_linked(site), key=lambda block: block.block_id)),
    )


def _contradictions(site: Site) -> Iterator[InputError]:
    for i in range(len(site.blocks)):
        yield from _check_block(site, i)
    regions = {f"ot_reachable[{i}]": region for i, region in enumerate(site.ot_reachable)}
    regions |= {f"safe_stop_zones[{i}]": region for i, region in enumerate(site.safe_stop_zones)}
    regions["geofence"] = site.geofence
    polygons: dict[str, list[Point]] = {}
    for field, region in regions.items():
        try:
            polygons[field] = region_polygon(site, region, field)
        except InputError as error:
            # A block without a line is an error of its own.
            if not (error.field or "").startswith("blocks"):
                yield error
    fence = polygons.pop("geofence", None)
    if fence is not None:
        yield from _outside_fence(polygons, fence)


def region_polygon(site: Site, region: Region, field: str = "region") -> list[Point]:
    """Return corners of a region in frame map, in order; a strip's start at its right entry.

    A strip along a bend gets as many points as keep its outline within 2 cm.

    Raises:
        InputError: it names no block, is empty, or lies where the block has no coordinates.
    """
    if not isinstance(region, Strip):
        return _legal(list(region.points), f"{field}.points")
    index = next((i for i, b in enumerate(site.blocks) if b.id == region.block), None)
    if index is None:
        raise InputError(
            "is no block of this site",
            field=f"{field}.block",
            value=region.block,
            remedy=f"its blocks are {', '.join(b.id for b in site.blocks)}",
        )
    for low, high in (("from_s_m", "to_s_m"), ("from_l_m", "to_l_m")):
        if not getattr(region, low) < getattr(region, high):
            raise InputError(
                f"must be above {low}",
                field=f"{field}.{high}",
                value=getattr(region, high),
                remedy=f"more than {getattr(region, low):g} m",
            )
    line = site_line(site.blocks[index], f"blocks[{index}]")
    try:
        right = line.path(region.from_s_m, region.to_s_m, region.from_l_m, _REGION_ERROR_M)
        left = line.path(region.to_s_m, region.from_s_m, region.to_l_m, _REGION_ERROR_M)
    except NotOneToOne as error:
        raise InputError(str(error), field=field, remedy="give it as a polygon") from error
    except ValueError as error:
        raise InputError(
            str(error), field=field, remedy="mend the region, or give it as a polygon"
        ) from error
    return _legal([*right, *left], field)


def _legal(points: list[Point], field: str) -> list[Point]:
    problem = outline_problem(points)
    if problem is not None:
        raise InputError(problem[0], field=field, remedy=problem[1])
    return points


def _outside_fence(polygons: dict[str, list[Point]], fence: list[Point]) -> Iterator[InputError]:
    """Yield regions that leave the fence by more than 1 mm, or that the fence cuts into."""
    import shapely  # type: ignore[import-untyped]  # slow to import, no types

    inside = shapely.Polygon(fence)
    shapely.prepare(inside)
    for name, polygon in polygons.items():
        whole = shapely.Polygon(polygon)
        # What is thinner than that counts as it is.
        core = whole.buffer(-_INSIDE_M, join_style="mitre")
        if inside.covers(whole if core.is_empty else core):
            continue
        out = shapely.get_coordinates(whole.difference(inside))
        far_m = shapely.distance(inside, shapely.points(out))
        x, y = out[int(far_m.argmax())]
        yield InputError(
            f"leaves the geofence by {far_m.max():.3f} m at x {x:.2f} m, y {y:.2f} m",
            field=name,
            remedy="draw it inside the fence, to 1 mm",
        )
