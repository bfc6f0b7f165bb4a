"""What labels are proposed from: states of a bag or a truth file, and the rules of K*."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal, TypeVar

from pydantic import ConfigDict, Field

from ssp_core.bag.reader import BagReader
from ssp_core.clock import seconds_to_ns
from ssp_core.errors import InputError
from ssp_core.files import parse_mapping, parse_model, read_text
from ssp_core.motion.encounter import Observable
from ssp_core.motion.state import ObjectState, Size
from ssp_core.names import VUT_ID
from ssp_core.run_file.model import ConflictThresholds
from ssp_core.run_file.values import Strict
from ssp_core.vocabulary import ObjectClass, Role
from ssp_eval.data.provenance import Provenance, read_provenance
from ssp_eval.recordings.event import Window, event_observable, event_thresholds, window_of
from ssp_eval.recordings.geometry import DEFAULT_MOTION, MotionThresholds
from ssp_eval.recordings.states import frame_times, read_states
from ssp_scenario_manager.compile.task import EVENT_FILE
from ssp_scenario_manager.event_spec.load import event_version, load_event
from ssp_scenario_manager.event_spec.model import Event


@dataclass(frozen=True)
class ProposalRules:
    """Everything that a proposal depends on besides the states.

    Args:
        count: labels on a clock grid, at least one.
        spacing_s: between labels on a clock grid.
        hfov_rad: the camera's horizontal field of view where the clip doesn't know it.
        range_m: beyond it an object doesn't count as visible.
        motion: thresholds of the motion classes.
    """

    count: int = 9
    spacing_s: float = 0.5
    hfov_rad: float = math.radians(75.0)
    range_m: float = 80.0
    motion: MotionThresholds = DEFAULT_MOTION


@dataclass(frozen=True)
class Truth:
    """Ground truth of one clip.

    Args:
        scenario: name.
        domain: of METHOD 5.2.
        event_version: K* version.
        start_s: clip time from which labels are possible (the first frame).
        end_s: clip time of the last frame.
        vut_id: object id of the VUT.
        target_ids: the OTs.
        series: (clip time in s, states of all objects), times rising.
        source: the file, for messages.
        hfov_rad: of the forward camera, None: not known.
        thresholds: the event's own, where its K* or its run gives them.
        observable: what makes the manoeuvre observable, None: not known.
        rules_of: whose thresholds and observable these are, for people.
        frames_s: clip times of the frames, rising.
        window: of the source's crop (METHOD 4.1), None: nobody knows it.
    """

    scenario: str
    domain: str
    event_version: str
    start_s: float
    end_s: float
    vut_id: str
    target_ids: tuple[str, ...]
    series: Sequence[tuple[float, Sequence[ObjectState]]]
    source: str
    hfov_rad: float | None = None
    thresholds: ConflictThresholds = field(default_factory=ConflictThresholds)
    observable: Observable | None = None
    rules_of: str = "no K*, the defaults"
    frames_s: Sequence[float] = ()
    window: Window | None = None


DEFAULT_RULES = ProposalRules()


# A labels file must name a version; this one says that nobody knows it.
UNKNOWN_VERSION = "unknown"


@dataclass(frozen=True)
class KStar:
    """A K*, its version, and how it was found, for people."""

    event: Event
    version: str
    said_by: str


@dataclass(frozen=True)
class EventRules:
    """What labels take from a K*, or from the run; None: nobody says.

    Args:
        thresholds: of the conflict.
        observable: what makes the manoeuvre observable.
        window: of the source's crop (METHOD 4.1).
        said_by: who says so, for people.
    """

    thresholds: ConflictThresholds | None
    observable: Observable | None
    window: Window | None
    said_by: str


def given_event(name_or_path: str) -> KStar:
    """The K* that a user names.

    Raises:
        InputError: see load_event.
    """
    event, version = load_event(name_or_path)
    return KStar(event, version, f"K* {event.name}")


def attached_event(bag: BagReader) -> KStar | None:
    """The K* in a bag, None: it holds none.

    Raises:
        InputError: it isn't valid.
    """
    data = bag.attachment(EVENT_FILE)
    if data is None:
        return None
    place = f"{bag.path}:{EVENT_FILE}"
    event = parse_model(Event, parse_mapping(data, place), place)
    return KStar(event, event_version(event), f"the K* {event.name} in the recording")


def shipped_event(scenario: str | None, version: str | None) -> KStar | None:
    """The shipped K* of a scenario, None: there is none, or not of this version.

    Args:
        scenario: name.
        version: that it must have; None or UNKNOWN_VERSION: any.
    """
    if scenario is None:
        return None
    try:
        event, found = load_event(scenario)
    except InputError:
        return None
    if version not in (found, None, UNKNOWN_VERSION):
        return None
    return KStar(event, found, f"the shipped K* {event.name}")


def rules_of(
    k_star: KStar | None, provenance: Provenance | None, scenario: str | None, version: str | None
) -> EventRules:
    """The rules for a recording: the K*'s, else the run's, else none.

    Args:
        k_star: that was given or lies in the bag.
        provenance: of the bag; None: it is a clip's truth file.
        scenario: name.
        version: K* version that the recording or the user names.
    """
    run = None if provenance is None else provenance.run
    found = k_star or shipped_event(scenario, version)
    if found is not None:
        event = found.event
        observable = event_observable(event) or (None if run is None else run.observable)
        return EventRules(event_thresholds(event), observable, window_of(event), found.said_by)
    if run is not None:
        return EventRules(run.thresholds, run.observable, None, "the recorded run")
    why = f"none is shipped for {scenario}"
    if scenario is not None and shipped_event(scenario, None) is not None:
        why = f"the shipped {scenario} is not {version}"
    return EventRules(None, None, None, f"no K*, the defaults: {why}")


Word = TypeVar("Word", bound=IntEnum)


class TruthSize(Strict):
    """Extent from the reference point, m."""

    front_m: float
    rear_m: float
    width_m: float
    height_m: float


class TruthObject(Strict):
    """One object of a truth file, fields as in ssp_core.motion.state.ObjectState."""

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
    given: KStar | None = None,
) -> Truth:
    """Ground truth that a clip's maker wrote beside it, in the clip's own time.

    Args:
        path: the truth file.
        domain: of the clip, where it isn't the one that the file names (METHOD 5.2).
        event_version: K* version, where the file names none.
        given: the K*, for its rules. Where it isn't given, the shipped K* of this scenario is
            taken, unless another version is named.

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
    rules = rules_of(given, None, found.scenario, version)
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
        thresholds=rules.thresholds or ConflictThresholds(),
        observable=rules.observable,
        rules_of=rules.said_by,
        frames_s=tuple(t_s for t_s, _ in series),
        window=rules.window,
    )


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


def truth_from_bag(
    path: str | Path,
    given: KStar | None = None,
    truth_file: Path | None = None,
    version: str | None = None,
) -> Truth:
    """Ground truth of a recording, in clip time: simulated, live, or another's with states.

    Args:
        path: of the bag.
        given: the K*, where the bag holds none.
        truth_file: that its clip's maker wrote, for a bag of a video without states.
        version: K* version, where the recording names none.

    Raises:
        InputError: it is no recording, never ran, holds no states or frames, or realises another
            K* than the one that is given.
    """
    with BagReader(path) as bag:
        provenance = read_provenance(bag)
        k_star = attached_event(bag) or given
        frames_s, zero_ns = frame_times(bag, provenance)
        states = read_states(bag, provenance, zero_ns)
    version = _version(path, provenance, given, version)
    rules = rules_of(k_star, provenance, provenance.scenario, version)
    if truth_file is not None:
        return _of_clip(path, provenance, rules, frames_s, truth_file, version)
    who = provenance.participants
    start_s, end_s = max(0.0, frames_s[0]), frames_s[-1]
    series = [
        (t_s, list(now.values())) for t_s, now in states.series if start_s <= t_s <= end_s
    ]  # fmt: skip
    if who is None or not series:
        raise InputError(
            "holds no states",
            file=path,
            remedy="give the clip's own --truth file, or write labels by hand (--template)",
        )
    return Truth(
        scenario=_scenario(path, provenance, k_star),
        domain=provenance.domain,
        event_version=version,
        start_s=start_s,
        end_s=end_s,
        vut_id=who.vut,
        target_ids=tuple(who.targets),
        series=series,
        source=str(path),
        hfov_rad=_hfov_rad(provenance),
        thresholds=rules.thresholds or ConflictThresholds(),
        observable=rules.observable,
        rules_of=rules.said_by,
        frames_s=frames_s,
        window=rules.window,
    )


def _of_clip(
    path: str | Path,
    provenance: Provenance,
    rules: EventRules,
    frames_s: tuple[float, ...],
    truth_file: Path,
    version: str,
) -> Truth:
    """A video's frames with the states of its truth file, on the video's clock."""
    found = truth_from_file(truth_file, provenance.domain, version)
    crop = None if provenance.imported is None else provenance.imported.crop.get("start_s")
    shift_s = float(crop) if isinstance(crop, int | float) else 0.0
    start_s, end_s = max(0.0, frames_s[0]), frames_s[-1]
    series = [
        (t_s - shift_s, states) for t_s, states in found.series if start_s <= t_s - shift_s <= end_s
    ]
    if not series:
        raise InputError(
            f"has no states within the clip, {start_s:.2f} to {end_s:.2f} s",
            file=truth_file,
            remedy=f"it must be of the video in {path}",
        )
    return replace(
        found,
        scenario=provenance.scenario or found.scenario,
        event_version=version,
        start_s=start_s,
        end_s=end_s,
        series=series,
        thresholds=rules.thresholds or found.thresholds,
        observable=rules.observable or found.observable,
        rules_of=rules.said_by,
        frames_s=frames_s,
        window=rules.window or found.window,
    )


def _version(
    path: str | Path, provenance: Provenance, given: KStar | None, named: str | None
) -> str:
    told = provenance.event_version
    for other in (None if given is None else given.version, named):
        if told is not None and other not in (None, told):
            raise InputError(
                f"realises K* {told}, given is {other}",
                file=path,
                remedy="give the K* that the recording was made from",
            )
    return told or named or (None if given is None else given.version) or UNKNOWN_VERSION


def _scenario(path: str | Path, provenance: Provenance, k_star: KStar | None) -> str:
    found = provenance.scenario or (None if k_star is None else k_star.event.name)
    if found is None:
        raise InputError(
            "doesn't say which scenario it shows", file=path, remedy="give its K* with --event"
        )
    return found


def _hfov_rad(provenance: Provenance) -> float | None:
    """Of the forward camera; None: nobody knows it."""
    run, imported = provenance.run, provenance.imported
    if run is not None:
        return None if run.camera is None else math.radians(run.camera.hfov_deg)
    hfov_deg = None if imported is None else imported.camera.hfov_deg
    return None if hfov_deg is None else math.radians(hfov_deg)
