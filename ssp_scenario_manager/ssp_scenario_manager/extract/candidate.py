"""The candidate K* from a model's answers: intervals, ``unresolved``, and defaults for part C."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

from ssp_core.errors import InputError
from ssp_core.names import VUT_ID
from ssp_scenario_manager.event_spec.model import (
    IDENTITY_BY_DEFAULT,
    SCHEMA,
    UNRESOLVED,
    BoundaryWord,
    CameraNeed,
    Doubt,
    Event,
    Evidence,
    Interval,
    ManoeuvreWord,
    RoadTypeWord,
    SafetyNeed,
    SiteNeed,
    Thresholds,
)
from ssp_scenario_manager.extract.answers import Finding
from ssp_scenario_manager.extract.clip import Clip
from ssp_scenario_manager.extract.interview import Interview, Target
from ssp_scenario_manager.extract.questions import CELL_PHASES, NONE, PHASES_ASKED
from ssp_scenario_manager.scenarios.base import Kind
from ssp_scenario_manager.scenarios.events.kinds import KINDS

SOURCE = "default of `ssp spec extract`"


def _interval(low: float | None, high: float | None, unit: str) -> Interval:
    return Interval(min=low, max=high, unit=unit)


# A camera that shows neighbouring lanes and kerbs, at a rate that METHOD 6.1 can match.
CAMERA = CameraNeed(
    hfov=_interval(60, 100, "deg"),
    width=_interval(640, None, "px"),
    rate=_interval(10, 60, "Hz"),
    visible_fraction=_interval(0.8, 1, "1"),
)
# Where a place may differ from the source in T, as long as the event takes place there.
ROAD_WORDS: dict[str, tuple[str, ...]] = {
    "road_type": get_args(RoadTypeWord),
    "left_boundary": get_args(BoundaryWord),
    "right_boundary": get_args(BoundaryWord),
    "permitted_manoeuvres": get_args(ManoeuvreWord),
}
ROAD_RANGES = {
    "lane_width": _interval(3, 4.2, "m"),
    "curvature": _interval(0, 0.001, "1/m"),
}


def road_words(name: str, source_words: Collection[str]) -> dict[str, object]:
    """Return how a field of words may differ: any word.

    Of manoeuvres, those that the source doesn't show.
    """
    words = ROAD_WORDS[name]
    if name == "permitted_manoeuvres":
        words = tuple(word for word in words if word not in source_words)
    return {"varies": words} if words else {"identity": True}


# Room to reach city speed, for the event, and to stop from it.
SITE = SiteNeed(
    length=_interval(250, None, "m"),
    lateral_clearance=_interval(1.5, None, "m"),
)
# Ω_safe of closed-track sessions with soft targets.
SAFETY = SafetyNeed(
    speed=_interval(None, 15, "m/s"),
    acceleration=_interval(None, 4.5, "m/s^2"),
    separation=_interval(0.5, None, "m"),
    duration=_interval(None, 60, "s"),
)


def thresholds(kind: Kind) -> Thresholds:
    """Return METHOD 1's default start of a conflict, with an arrival gap if the kind has one."""
    default = Thresholds()
    return default if kind.uses_arrival_gap else default.model_copy(update={"arrival_gap": None})


_Provenance = Literal["frame", "model", "person", "derived", "standard"]
_NO_SCALE = "one camera gives no absolute speed or distance"


@dataclass(frozen=True)
class Origin:
    """The facts known about the clip besides its pixels.

    Args:
        original: version or name of the original.
        kind: kind of interaction that a person states, None: the model's answer.
    """

    name: str
    generator: str
    original: str
    kind: str | None = None


class _Draft:
    """The mapping that becomes a candidate, and part U beside it."""

    def __init__(self, clip: Clip, model: str) -> None:
        self._clip, self._model = clip, model
        self.doubts: dict[str, Doubt] = {}

    def model_value(self, path: str, finding: Finding, value: Any = None) -> Any:
        """Return a value of the model's, with the frames that it named."""
        numbers = ", ".join(str(self._clip.shots[i - 1].number) for i in finding.frames)
        self._doubt(path, finding.confidence, "model", f"{self._model}; frames {numbers}")
        return finding.value if value is None else value

    def derived(self, path: str, value: Any, source: str, confidence: float = 1.0) -> Any:
        self._doubt(path, confidence, "derived", source)
        return value

    def standard(self, path: str, value: Any, confidence: float = 1.0) -> Any:
        self._doubt(path, confidence, "standard", SOURCE)
        return value

    def unknown(self, path: str, source: str = _NO_SCALE) -> str:
        self._doubt(path, 0.0, "frame", source)
        return UNRESOLVED

    def _doubt(self, path: str, confidence: float, provenance: _Provenance, source: str) -> None:
        self.doubts[path] = Doubt(
            confidence=confidence, provenance=provenance, source=source, review="unreviewed"
        )


def make_candidate(interview: Interview, clip: Clip, origin: Origin, model: str) -> Event:
    """Make the candidate.

    Raises:
        InputError: there is nothing to make an event of: no OT, or no conflict and no kind stated.
    """
    kind = _kind(interview, clip, origin)
    draft = _Draft(clip, model)
    ids = [target.id for target in interview.targets]
    draft.derived("name", None, "chosen at extraction")
    draft.derived("description", None, "kind of interaction, and the model's words about the OTs")
    draft.derived("source", None, "the video file and options of the extraction")
    value = {
        "schema": SCHEMA,
        "name": origin.name,
        "description": _description(kind, interview.targets),
        "source": {
            "generator": origin.generator,
            "original": origin.original,
            "sha256": clip.sha256,
            "rate": _exact(clip.rate_hz, "Hz"),
        },
        "topology": _topology(draft, interview),
        "participants": _participants(draft, interview),
        "motion": _motion(draft, interview),
        "interaction": _interaction(draft, interview, kind, origin),
        "events": _events(draft, interview, clip),
        "constraints": _constraints(draft, interview, kind, [VUT_ID, *ids]),
        "uncertainty": draft.doubts,
    }
    return Event.model_validate(value)


def _kind(interview: Interview, clip: Clip, origin: Origin) -> Kind:
    remedy = (
        "choose a crop that shows the event (--start, --end), more --frames, or another model; or "
        "refuse the clip"
    )
    if not interview.targets:
        raise InputError("shows no conflict with the VUT", file=clip.video, remedy=remedy)
    answer = interview.interaction["type"].value
    if origin.kind is None and answer == NONE:
        raise InputError(
            "shows no identifiable conflict, the model says",
            file=clip.video,
            remedy=remedy + "; where you see one, state its kind with --type",
        )
    return KINDS[origin.kind or answer]


def _description(kind: Kind, targets: tuple[Target, ...]) -> str:
    who = "; ".join(f"{target.id}: {target.description}" for target in targets)
    return f"{kind.name}. {who}"


def _exact(value: float, unit: str) -> dict[str, Any]:
    rounded = round(value, 6)
    return {"min": rounded, "max": rounded, "unit": unit}


def _topology(draft: _Draft, interview: Interview) -> dict[str, Any]:
    """Return part T: segment, lane counts and VUT lane are identity, the rest varies by default."""
    answers = {**interview.road, "vut_lane": interview.vut["vut_lane"]}
    part: dict[str, Any] = {}
    for name, finding in answers.items():
        value = draft.model_value(f"topology.{name}", finding)
        if name in IDENTITY_BY_DEFAULT:
            part[name] = {"value": _count_or_word(value), "identity": True}
        else:
            part[name] = {"value": value, **road_words(name, value)}
    for name, varies in ROAD_RANGES.items():
        part[name] = {"value": draft.unknown(f"topology.{name}"), "varies": varies}
    return part


def _count_or_word(value: Any) -> Any:
    """Return a word as it is, a count as its number, or `unresolved` for a range."""
    if not isinstance(value, Mapping):
        return value
    return value["min"] if value["min"] == value["max"] else UNRESOLVED


def _participants(draft: _Draft, interview: Interview) -> dict[str, Any]:
    at = f"participants.{VUT_ID}"
    own = interview.vut["class"]
    if own.value == UNRESOLVED:
        own_class = draft.standard(f"{at}.class", "car", confidence=0.0)
    else:
        own_class = draft.model_value(f"{at}.class", own)
    region = {"place": "vut_lane", "along": "at", "gap": _exact(0.0, "m")}
    part = {
        VUT_ID: {
            "role": draft.derived(f"{at}.role", "VUT", "carries the camera"),
            "class": own_class,
            "intent": draft.model_value(f"{at}.intent", interview.vut["intent"]),
            "region": draft.derived(f"{at}.region", region, "carries the camera"),
        }
    }
    for target in interview.targets:
        at = f"participants.{target.id}"
        part[target.id] = {
            "role": draft.derived(f"{at}.role", "OT", "seen by the camera"),
            "class": draft.model_value(f"{at}.class", target.listed, target.listed.value["class"]),
            "region": {
                "place": draft.model_value(f"{at}.region.place", target.place["place"]),
                "along": draft.model_value(f"{at}.region.along", target.place["along"]),
                "gap": draft.unknown(f"{at}.region.gap"),
            },
        }
    return part


def _motion(draft: _Draft, interview: Interview) -> dict[str, Any]:
    part: dict[str, Any] = {}
    for who, cells in interview.motion.items():
        part[who] = {}
        for phase, finding in cells.items():
            fixed = {"heading": "same", "longitudinal": "none"} if who == VUT_ID else {}
            path = f"motion.{who}.{phase}"
            part[who][phase] = draft.model_value(path, finding, {**fixed, **finding.value})
    return part


def _interaction(draft: _Draft, interview: Interview, kind: Kind, origin: Origin) -> dict[str, Any]:
    answers, at = interview.interaction, "interaction"
    initiator = draft.model_value(f"{at}.initiator", answers["initiator"])
    first = answers["first"]
    order = [VUT_ID, initiator] if first.value == VUT_ID else [initiator, VUT_ID]
    hides = answers["occluder"]
    occluder = draft.model_value(f"{at}.occluder", hides)
    part: dict[str, Any] = {
        "initiator": initiator,
        "affected": draft.derived(f"{at}.affected", VUT_ID, "an event is about the VUT"),
        "occluder": None if occluder == NONE else occluder,
        "relation": draft.derived(f"{at}.relation", kind.relation, f"type {kind.name}"),
        "zone": draft.derived(f"{at}.zone", kind.zone, f"type {kind.name}"),
        "passing_order": draft.model_value(f"{at}.passing_order", first, order),
    }
    if origin.kind is None:
        part["type"] = draft.model_value(f"{at}.type", answers["type"])
    else:
        part["type"] = kind.name
        draft.doubts[f"{at}.type"] = Doubt(
            confidence=1.0, provenance="person", source="option --type", review="unreviewed"
        )
    for key in ("dominant_motion", "longitudinal_responses", "lateral_responses"):
        part[key] = draft.model_value(f"{at}.{key}", answers[key])
    return part


def _events(draft: _Draft, interview: Interview, clip: Clip) -> dict[str, Any]:
    """Place phases between frames; evidence runs from a phase's first frame to its last."""
    end = round(clip.duration_s, 6)
    draft.derived("events.clip", None, "the crop")
    draft.derived("events.approach.start", None, "the approach starts with the clip")
    part: dict[str, Any] = {"clip": {"start": _exact(0.0, "s"), "end": _exact(end, "s")}}
    firsts: dict[str, int | None] = {"approach": 1}
    for phase in PHASES_ASKED:
        value = interview.phases[phase].value
        firsts[phase] = None if value == UNRESOLVED else value
    for phase, after in zip(CELL_PHASES, (*PHASES_ASKED, None), strict=True):
        first, finding = firsts[phase], interview.phases.get(phase)
        start: Any = _exact(0.0, "s")
        if finding is not None:
            start = draft.model_value(f"events.{phase}.start", finding, _between(clip, first))
        if first is None:
            # Nobody knows when it starts; what the model looked at is all the evidence there is.
            looked = finding.frames if finding is not None else (1,)
            span = looked[0], looked[-1]
        else:
            until = len(clip.shots) + 1 if after is None else firsts[after]
            span = first, first if until is None else max(first, until - 1)
        source = "frames from its start to the next phase"
        part[phase] = {
            "start": start,
            "evidence": draft.derived(f"events.{phase}.evidence", [_evidence(clip, span)], source),
        }
    return part


def _between(clip: Clip, first: int | None) -> Any:
    """Return the interval of a phase's start by its known first frame, on the clip's clock."""
    if first is None:
        return UNRESOLVED
    latest_s = clip.shots[first - 1].t_s
    earliest_s = clip.shots[first - 2].t_s if first > 1 else latest_s
    return {"min": round(earliest_s, 3), "max": round(latest_s, 3), "unit": "s"}


def _evidence(clip: Clip, span: tuple[int, int]) -> dict[str, Any]:
    first, last = (clip.shots[i - 1] for i in span)
    # With an uneven frame rate, a number says another time than the frame's own.
    off_s = max(abs(shot.number / clip.rate_hz - shot.t_s) for shot in (first, last))
    frames = (first.number, last.number) if off_s <= 0.4 / clip.rate_hz else None
    span_s = (round(first.t_s, 3), round(last.t_s, 3))
    return Evidence(frames=frames, span_s=span_s).model_dump(mode="json")


def _constraints(draft: _Draft, interview: Interview, kind: Kind, ids: list[str]) -> dict[str, Any]:
    at = "constraints"
    initiator = interview.interaction["initiator"].value
    draft.unknown(f"{at}.speeds")
    draft.unknown(f"{at}.manoeuvre")
    quantity = sorted(kind.trigger_quantities)[0]
    return {
        "speeds": {who: _speeds(draft, who, interview.motion[who]) for who in ids},
        "trigger": {
            "quantity": draft.derived(f"{at}.trigger.quantity", quantity, f"type {kind.name}"),
            "object": draft.derived(f"{at}.trigger.object", initiator, "interaction.initiator"),
            "below": draft.unknown(f"{at}.trigger.below"),
        },
        "manoeuvre": dict.fromkeys(kind.manoeuvre, UNRESOLVED),
        "time_gap": draft.unknown(f"{at}.time_gap"),
        "thresholds": draft.standard(f"{at}.thresholds", thresholds(kind)),
        "camera": draft.standard(f"{at}.camera", CAMERA),
        "site": draft.standard(f"{at}.site", SITE),
        "safety": draft.standard(f"{at}.safety", SAFETY),
        "weights": draft.standard(f"{at}.weights", {}),
    }


def _speeds(draft: _Draft, who: str, cells: Mapping[str, Finding]) -> dict[str, Any]:
    part: dict[str, Any] = {}
    for phase, finding in cells.items():
        part[phase] = UNRESOLVED
        if finding.value["speed_trend"] == "standing":
            part[phase] = draft.derived(
                f"constraints.speeds.{who}.{phase}",
                _exact(0.0, "m/s"),
                f"motion.{who}.{phase}: it stands",
                finding.confidence,
            )
    return part
