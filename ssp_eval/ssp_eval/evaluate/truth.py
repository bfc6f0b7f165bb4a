"""Ground truth of a clip for label proposals: from a recorded session or a clip's truth file.

Only `ssp labels` and `--propose-labels` read it. No request is ever built from it.
"""

from __future__ import annotations

import json
import math
from enum import IntEnum
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal, TypeVar

from pydantic import ConfigDict, Field

from ssp_core.bag import BagReader
from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.errors import InputError
from ssp_core.files import parse_model, read_text
from ssp_core.interaction import Observable
from ssp_core.messages import object_state, peek_stamp_ns, stamp_ns
from ssp_core.names import CAMERA_IMAGE, VUT_ID, WORLD_TICK, absolute
from ssp_core.run_spec import ConflictThresholds, Strict
from ssp_core.state import ObjectState, Size
from ssp_core.vocab import ObjectClass, Role
from ssp_eval.labels.basis import Truth
from ssp_eval.recordings.provenance import read_provenance
from ssp_scenario_manager.interactions import KINDS
from ssp_scenario_manager.spec.load import load_event
from ssp_scenario_manager.spec.model import Event, Interval

_TICK = absolute(WORLD_TICK)
_IMAGE = absolute(CAMERA_IMAGE)
# A labels file must name a version; this one says that nobody knows it.
UNKNOWN_VERSION = "unknown"

Word = TypeVar("Word", bound=IntEnum)


def truth_from_bag(path: str | Path) -> Truth:
    """Ground truth of a recorded session, in clip time.

    Raises:
        InputError: it is no bag of a session, never ran, or holds no ground truth or frames.
    """
    with BagReader(path) as bag:
        provenance = read_provenance(bag)
        run = provenance.run
        if run is None:
            raise InputError(
                "is an imported video and holds no ground truth",
                file=path,
                remedy="give the clip's own --truth file, or write labels by hand",
            )
        start_ns = provenance.session_start_ns
        if start_ns is None:
            raise InputError("holds a session that never reached RUNNING", file=path)
        series = [
            (
                ns_to_seconds(stamp_ns(tick.header.stamp) - start_ns),
                [object_state(o) for o in tick.objects],
            )
            for tick in (bag.decode(message) for message in bag.messages([_TICK]))
            if tick.running and stamp_ns(tick.header.stamp) >= start_ns
        ]
        frames_s = sorted(
            ns_to_seconds(peek_stamp_ns(message.data) - start_ns)
            for message in bag.messages([_IMAGE])
        )
    if not series:
        raise InputError(f"holds no ground truth (no message on {_TICK})", file=path)
    if not frames_s:
        raise InputError(f"has no camera frames (no message on {_IMAGE})", file=path)
    return Truth(
        scenario=run.scenario,
        domain=run.domain,
        event_version=run.event_version,
        start_s=max(0.0, frames_s[0]),
        end_s=frames_s[-1],
        vut_id=run.vut.id,
        target_ids=tuple(target.id for target in run.targets),
        series=series,
        source=str(path),
        hfov_rad=None if run.camera is None else math.radians(run.camera.hfov_deg),
        thresholds=run.thresholds,
        observable=run.observable,
        rules_of="the recorded run",
    )


class TruthSize(Strict):
    """Extent from the reference point, m."""

    front_m: float
    rear_m: float
    width_m: float
    height_m: float


class TruthObject(Strict):
    """One object of a truth file, fields as in ssp_core.state.ObjectState."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    object_id: str
    object_class: int | str
    role: int | str = int(Role.UNKNOWN)
    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    acceleration_mps2: float = 0.0
    yaw_rate_radps: float = 0.0
    size: TruthSize


class TruthFrame(Strict):
    """All objects at one clip time."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    t_s: float
    objects: list[TruthObject]


class TruthCamera(Strict):
    """The clip's camera, as far as labels need it."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    hfov_deg: Annotated[float, Field(gt=1, lt=180)] | None = None


class TruthFile(Strict):
    """``ssp.truth/1``: what the maker of a clip knows about it."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    schema_: Literal["ssp.truth/1"] = Field(alias="schema")
    scenario: str
    domain: str = "synthetic"
    event_version: str | None = None
    camera: TruthCamera = TruthCamera()
    frames: Annotated[list[TruthFrame], Field(min_length=1)]


def truth_from_file(
    path: str | Path,
    domain: str | None = None,
    event_version: str | None = None,
    event: Event | None = None,
) -> Truth:
    """Ground truth that a clip's maker wrote beside it, in the clip's own time.

    Args:
        path: the truth file.
        domain: of the clip, where it isn't the one that the file names (METHOD 5.2).
        event_version: K* version, where the file names none.
        event: the K*, for its thresholds and what it makes observable. Where it isn't given, the
            shipped K* of this scenario is taken, unless another version is named.

    Raises:
        InputError: it is not valid, or the frames' times don't rise.
    """
    # Such a file is large, and always JSON: the YAML reader would take seconds.
    try:
        value = json.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise InputError(f"is no JSON: {error}", file=path) from error
    found = parse_model(TruthFile, value, path)
    for before, after in pairwise(found.frames):
        if after.t_s <= before.t_s:
            raise InputError("must rise strictly", file=path, field="frames.t_s", value=after.t_s)
    series = [(f.t_s, [_object(o, f.t_s, path) for o in f.objects]) for f in found.frames]
    first = series[0][1]
    targets = tuple(state.object_id for state in first if state.role is Role.OT)
    version = found.event_version or event_version or UNKNOWN_VERSION
    rules_of = "" if event is None else f"K* {event.name}"
    if event is None:
        event, rules_of = _shipped_event(found.scenario, version)
    return Truth(
        scenario=found.scenario,
        domain=domain or found.domain,
        event_version=version,
        start_s=series[0][0],
        end_s=series[-1][0],
        vut_id=next((s.object_id for s in first if s.role is Role.VUT), VUT_ID),
        target_ids=targets or tuple(s.object_id for s in first if s.object_id != VUT_ID),
        series=series,
        source=str(path),
        hfov_rad=None if found.camera.hfov_deg is None else math.radians(found.camera.hfov_deg),
        thresholds=ConflictThresholds() if event is None else event_thresholds(event),
        observable=None if event is None else event_observable(event),
        rules_of=rules_of,
    )


def _shipped_event(scenario: str, version: str) -> tuple[Event | None, str]:
    """The shipped K* of a scenario, None: it is none of this version; and whose rules hold."""
    try:
        event, found = load_event(scenario)
    except InputError:
        return None, f"no K*, the defaults: none is shipped for {scenario}"
    if version not in (found, UNKNOWN_VERSION):
        return None, f"no K*, the defaults: the shipped {scenario} is not {version}"
    return event, f"the shipped K* {event.name}"


def event_thresholds(event: Event) -> ConflictThresholds:
    """A K*'s thresholds of the conflict (METHOD 1), in s; an interval counts with its middle."""
    limits = event.constraints.thresholds
    return ConflictThresholds(ttc_s=_middle(limits.ttc), arrival_gap_s=_middle(limits.arrival_gap))


def _middle(interval: Interval | None) -> float | None:
    if interval is None:
        return None
    ends = [end for end in (interval.min, interval.max) if end is not None]
    return sum(ends) / len(ends) if ends else None


def event_observable(event: Event) -> Observable | None:
    """What makes the manoeuvre of a K*'s kind of interaction observable, None: no such kind."""
    kind = KINDS.get(event.interaction.type)
    return None if kind is None else kind.observable


def _object(found: TruthObject, t_s: float, path: str | Path) -> ObjectState:
    return ObjectState(
        object_id=found.object_id,
        object_class=_member(ObjectClass, found.object_class, "object_class", path),
        role=_member(Role, found.role, "role", path),
        stamp_ns=seconds_to_ns(t_s),
        x_m=found.x_m,
        y_m=found.y_m,
        yaw_rad=found.yaw_rad,
        speed_mps=found.speed_mps,
        acceleration_mps2=found.acceleration_mps2,
        yaw_rate_radps=found.yaw_rate_radps,
        size=Size(**found.size.model_dump()),
    )


def _member(enum: type[Word], given: int | str, field: str, path: str | Path) -> Word:
    """The member of an enumeration by its number or its word."""
    try:
        return enum[given.upper()] if isinstance(given, str) else enum(given)
    except (KeyError, ValueError):
        words = ", ".join(member.name.lower() for member in enum)
        raise InputError(
            "is not known", file=path, field=field, value=given, remedy=f"known are {words}"
        ) from None
