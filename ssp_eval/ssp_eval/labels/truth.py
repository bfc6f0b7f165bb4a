"""The source of proposed labels: states of a bag or a truth file, and the rules of K*."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import ConfigDict, Field, model_validator

from ssp_core.bag.reading.reader import BagReader
from ssp_core.clock import seconds_to_ns
from ssp_core.errors import InputError
from ssp_core.files.reading import parse_model, read_text
from ssp_core.files.strict_json import parse_strict
from ssp_core.hashing import sha256_file
from ssp_core.motion.state import ObjectState, Size
from ssp_core.motion.state_series import StateSeries, between
from ssp_core.names import VUT_ID
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.values import Strict
from ssp_core.video import Video
from ssp_core.vocabulary import DOMAINS, ObjectClass, ObjectWord, Role
from ssp_eval.data.labels import Name, one_of
from ssp_eval.data.provenance import Provenance, read_provenance
from ssp_eval.recordings.event import NO_RULES, EventRules, rules_of
from ssp_eval.recordings.states import NO_STATES, RecordedStates, attached, frame_times, read_states
from ssp_scenario_manager.compile.task import EVENT_FILE
from ssp_scenario_manager.event_spec.load import event_version, load_event
from ssp_scenario_manager.event_spec.model import Event

# A labels file must name a version; this one says that nobody knows it.
UNKNOWN_VERSION = "unknown"


@dataclass(frozen=True)
class Truth:
    """Ground truth of one clip.

    Args:
        start_s: clip time from which labels are possible (the first frame).
        end_s: clip time of the last frame.
        series: (clip time in s, states of all objects), times rising.
        hfov_rad: of the forward camera, None: not known.
        frames_s: clip times of the frames, rising.
    """

    scenario: str
    domain: str
    event_version: str
    start_s: float
    end_s: float
    vut_id: str
    target_ids: tuple[str, ...]
    series: StateSeries | Sequence[tuple[float, Sequence[ObjectState]]]
    source: str
    hfov_rad: float | None = None
    rules: EventRules = NO_RULES
    frames_s: Sequence[float] = ()

    @property
    def states(self) -> StateSeries:
        """The series, with the states by id."""
        series = self.series
        return series if isinstance(series, StateSeries) else StateSeries(series)


@dataclass(frozen=True)
class KStar:
    """A K*, its version, and how it was found, for people."""

    event: Event
    version: str
    origin: str


def load_k_star(name_or_path: str) -> KStar:
    """Return the K* that a user names.

    Raises:
        InputError: see load_event.
    """
    event, version = load_event(name_or_path)
    return KStar(event, version, f"K* {event.name}")


def shipped_event(scenario: str | None, version: str | None) -> KStar | None:
    """Return the shipped K* of a scenario, None: there is none, or not of this version.

    Args:
        scenario: name of the event; None: not known.
        version: that it must have; None or UNKNOWN_VERSION: any.
    """
    if scenario is None:
        return None
    try:
        event, shipped_version = load_event(scenario)
    except InputError:
        return None
    if version not in (shipped_version, None, UNKNOWN_VERSION):
        return None
    return KStar(event, shipped_version, f"the shipped K* {event.name}")


def _rules(
    k_star: KStar | None, run: RunSpec | None, scenario: str | None, version: str | None
) -> EventRules:
    """Return a recording's rules: those of its K* or the shipped one, else the run's, else none."""
    reference = k_star or shipped_event(scenario, version)
    if reference is not None:
        return replace(rules_of(reference.event, run), origin=reference.origin)
    rules = rules_of(None, run)
    if run is not None:
        return rules
    why = f"none is shipped for {scenario}"
    if scenario is not None and shipped_event(scenario, None) is not None:
        why = f"the shipped {scenario} is not {version}"
    return replace(rules, origin=f"{rules.origin}: {why}")


@dataclass(frozen=True)
class Source:
    """A bag or a video file that is to be labelled, and what it says of itself.

    Args:
        frames_s: clip times of its frames, rising.
        provenance: of a bag; None: it is a video file.
        video_sha256: of the source video; None: there is none.
        zero_s: time of its source at clip time 0; 0 for what has no source.
        event: the K* in it; None: it holds none.
    """

    path: Path
    frames_s: tuple[float, ...]
    states: RecordedStates
    provenance: Provenance | None = None
    video_sha256: str | None = None
    zero_s: float = 0.0
    event: KStar | None = None

    @property
    def first_s(self) -> float:
        """Clip time from which labels are possible."""
        return max(0.0, self.frames_s[0])

    @property
    def last_s(self) -> float:
        """Clip time of the last frame."""
        return self.frames_s[-1]

    @property
    def origin(self) -> str | None:
        """Hash of what it is labelled from."""
        return self.video_sha256 if self.provenance is None else self.provenance.bag_sha256


def is_bag(path: Path) -> bool:
    """Tell whether a path names a bag rather than a video file."""
    return path.is_dir() or path.suffix == ".mcap"


def read_source(path: Path, start_s: float = 0.0) -> Source:
    """Read a recording.

    Args:
        path: a bag or a video.
        start_s: of a video, where its clip begins.

    Raises:
        InputError: it isn't there, is neither, has no frames, or is of a session that never ran.
    """
    if not path.exists():
        raise InputError(
            "is not there",
            file=path,
            remedy="name a recording: the folder of `ssp run` or of `ssp import-video`, a bag, or "
            "a video such as a .mp4",
        )
    if not is_bag(path):
        times_s = video_times(path, start_s)
        frames_s = tuple(t_s - times_s[0] for t_s in times_s)
        digest = sha256_file(path)
        return Source(path, frames_s, NO_STATES, video_sha256=digest, zero_s=times_s[0])
    with BagReader(path) as bag:
        provenance = read_provenance(bag)
        frames_s, zero_ns = frame_times(bag, provenance)
        states = read_states(bag, provenance, zero_ns)
        event = attached(bag, EVENT_FILE, Event)
    imported = provenance.imported
    crop_s = None if imported is None else imported.crop.get("start_s")
    return Source(
        path,
        frames_s,
        states,
        provenance,
        None if imported is None else imported.source_sha256,
        float(crop_s) if isinstance(crop_s, int | float) else 0.0,
        None
        if event is None
        else KStar(event, event_version(event), f"the K* {event.name} in the recording"),
    )


def video_times(path: Path, start_s: float) -> list[float]:
    """Return the times of a video's frames from a time on, s; raise InputError without any."""
    with Video(path) as video:
        times_s = [frame.time_s for frame in video.frames(start_s, None, 1)]
    if not times_s:
        raise InputError(
            f"has no frame from {start_s:g} s on",
            file=path,
            field="--start",
            remedy="give a --start within the video",
        )
    return times_s


class _TruthFields(Strict):
    """The part of a truth file that labels need; a clip's maker knows more."""

    model_config = ConfigDict(extra="ignore", frozen=True)


# Of a body, either way from its reference point; no road user is longer.
_Reach = Annotated[float, Field(ge=0.0, le=50.0)]
_Extent = Annotated[float, Field(gt=0.0, le=50.0)]


class TruthSize(Strict):
    """Extent from the reference point, m, which lies within the body."""

    front_m: _Reach
    rear_m: _Reach
    width_m: _Extent
    height_m: _Extent

    @model_validator(mode="after")
    def _has_length(self) -> Self:
        if self.front_m + self.rear_m <= 0.0:
            raise ValueError("has no length: front_m and rear_m are both 0")
        return self


class TruthObject(_TruthFields):
    """One object of a truth file, fields as in ssp_core.motion.state.ObjectState."""

    object_id: str
    object_class: ObjectWord
    role: Literal["unknown", "vut", "ot", "traffic"] = "unknown"
    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    acceleration_mps2: float = 0.0
    yaw_rate_radps: float = 0.0
    size: TruthSize

    def state(self, t_s: float) -> ObjectState:
        """Return its state at a clip time."""
        return ObjectState(
            object_class=ObjectClass.from_word(self.object_class),
            role=Role[self.role.upper()],
            stamp_ns=seconds_to_ns(t_s),
            size=Size(**self.size.model_dump()),
            **self.model_dump(exclude={"object_class", "role", "size"}),
        )


class TruthFrame(_TruthFields):
    """All objects at one clip time."""

    t_s: float
    objects: list[TruthObject]


class TruthCamera(_TruthFields):
    """The clip's camera."""

    hfov_deg: Annotated[float, Field(gt=1, lt=180)] | None = None


class TruthFile(_TruthFields):
    """``ssp.truth/1``: what the maker of a clip knows about it."""

    schema_: Literal["ssp.truth/1"] = Field(alias="schema")
    scenario: Name
    domain: Annotated[str, one_of(DOMAINS)] = "synthetic"
    event_version: str | None = None
    camera: TruthCamera = TruthCamera()
    frames: Annotated[list[TruthFrame], Field(min_length=1)]


def truth_from_file(
    path: str | Path,
    domain: str | None = None,
    event_version: str | None = None,
    k_star: KStar | None = None,
) -> Truth:
    """Read the ground truth that a clip's maker wrote beside it, in the clip's own time.

    Args:
        path: of the file.
        domain: of the clip, where it isn't the one that the file names (METHOD 5.2).
        event_version: K* version, where the file names none.
        k_star: for its rules. Where it isn't given, the shipped K* of this scenario is
            taken, unless another version is named.

    Raises:
        InputError: it is not valid, the frames' times don't rise, or an object isn't the same one
            in all frames.
    """
    # Such a file is large, and always JSON: the YAML reader would take seconds.
    try:
        value = parse_strict(read_text(path))
    except ValueError as error:
        raise InputError(
            f"is no JSON: {error}", file=path, remedy="write it as JSON (ssp.truth/1)"
        ) from error
    truth_file = parse_model(TruthFile, value, path)
    for before, after in pairwise(truth_file.frames):
        if after.t_s <= before.t_s:
            raise InputError(
                "must rise strictly",
                file=path,
                field="frames.t_s",
                value=after.t_s,
                remedy="sort the frames by time, each once",
            )
    _check_objects(truth_file, path)
    series = [(f.t_s, [one.state(f.t_s) for one in f.objects]) for f in truth_file.frames]
    first = series[0][1]
    targets = tuple(state.object_id for state in first if state.role is Role.OT)
    version = truth_file.event_version or event_version or UNKNOWN_VERSION
    return Truth(
        scenario=truth_file.scenario,
        domain=domain or truth_file.domain,
        event_version=version,
        start_s=series[0][0],
        end_s=series[-1][0],
        vut_id=next((s.object_id for s in first if s.role is Role.VUT), VUT_ID),
        target_ids=targets or tuple(s.object_id for s in first if s.object_id != VUT_ID),
        series=series,
        source=str(path),
        hfov_rad=None
        if truth_file.camera.hfov_deg is None
        else math.radians(truth_file.camera.hfov_deg),
        rules=_rules(k_star, None, truth_file.scenario, version),
        frames_s=tuple(t_s for t_s, _ in series),
    )


def _check_objects(truth_file: TruthFile, path: str | Path) -> None:
    """Refuse an object twice in a frame, one with two roles, and a second VUT."""
    roles: dict[str, str] = {}
    vut_id: str | None = None
    for i, frame in enumerate(truth_file.frames):
        ids: set[str] = set()
        for one in frame.objects:
            problem = None
            role = roles.setdefault(one.object_id, one.role)
            if one.object_id in ids:
                problem, remedy = "holds an object twice", "give each object one state per frame"
            elif one.role != role:
                problem = f"holds an object as {one.role} that was {role}"
                remedy = "give an object one role in all frames"
            elif one.role == "vut" and one.object_id != (vut_id := vut_id or one.object_id):
                problem = f"holds a second VUT beside {vut_id}"
                remedy = "give one object the role vut"
            if problem:
                raise InputError(
                    problem,
                    file=path,
                    field=f"frames[{i}].objects",
                    value=one.object_id,
                    remedy=remedy,
                )
            ids.add(one.object_id)


def truth_from_bag(path: str | Path) -> Truth:
    """Return the ground truth of a recording with states, in clip time."""
    return truth_of(read_source(Path(path)))


def truth_of(
    source: Source,
    fallback: KStar | None = None,
    truth_file: Path | None = None,
    version: str | None = None,
) -> Truth:
    """Return the ground truth of a bag, in clip time.

    Args:
        source: the bag, as read_source returns it.
        fallback: the K*, where the bag holds none.
        truth_file: that its clip's maker wrote, for a bag of a video without states.
        version: K* version, where the recording names none.

    Raises:
        InputError: it holds no states, or realises another K* than the one that is given.
    """
    facts, path = source.provenance, source.path
    if facts is None:
        raise InputError(
            "is a video file and no recording",
            file=path,
            remedy="import it (ssp import-video), or give its --truth file alone",
        )
    version = _version(path, facts, fallback, version)
    k_star = source.event or fallback
    start_s, end_s = source.first_s, source.last_s
    about: dict[str, Any] = {
        "domain": facts.domain,
        "event_version": version,
        "start_s": start_s,
        "end_s": end_s,
        "frames_s": source.frames_s,
    }
    if truth_file is not None:
        file_truth = truth_from_file(truth_file, event_version=version)
        shifted = [(t_s - source.zero_s, list(now.values())) for t_s, now in file_truth.states]
        series = [(t_s, states) for t_s, states in shifted if start_s <= t_s <= end_s]
        if not series:
            raise InputError(
                f"has no states within the clip, {start_s:.2f} to {end_s:.2f} s",
                file=truth_file,
                remedy=f"it must be of the video in {path}",
            )
        about["scenario"] = facts.scenario or file_truth.scenario
        rules = _rules(k_star, facts.run, about["scenario"], version)
        return replace(file_truth, series=series, rules=rules, **about)
    who = facts.participants
    states = between(source.states.series, start_s, end_s)
    if who is None or not isinstance(states, StateSeries) or not states:
        raise InputError(
            "holds no states",
            file=path,
            remedy="give the clip's own --truth file, or write labels by hand (--template)",
        )
    scenario = facts.scenario or (None if k_star is None else k_star.event.name)
    if scenario is None:
        raise InputError(
            "doesn't say which scenario it shows", file=path, remedy="give its K* with --event"
        )
    return Truth(
        scenario=scenario,
        vut_id=who.vut,
        target_ids=tuple(who.targets),
        series=states,
        source=str(path),
        hfov_rad=_hfov_rad(facts),
        rules=_rules(k_star, facts.run, facts.scenario, version),
        **about,
    )


def _version(
    path: str | Path, provenance: Provenance, k_star: KStar | None, version: str | None
) -> str:
    own_version = provenance.event_version
    for other in (None if k_star is None else k_star.version, version):
        if own_version is not None and other not in (None, own_version):
            raise InputError(
                f"realises K* {own_version}, given is {other}",
                file=path,
                remedy="give the K* that the recording was made from",
            )
    return own_version or version or (None if k_star is None else k_star.version) or UNKNOWN_VERSION


def _hfov_rad(provenance: Provenance) -> float | None:
    """Return the field of view of the forward camera; None: not known."""
    run, imported = provenance.run, provenance.imported
    if run is not None:
        return None if run.camera is None else math.radians(run.camera.hfov_deg)
    hfov_deg = None if imported is None else imported.camera.hfov_deg
    return None if hfov_deg is None else math.radians(hfov_deg)
