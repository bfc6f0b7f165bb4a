"""The labels file (METHOD 5.2, 5.2b): model, strict loading, writing, templates, comparison."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from ssp_core.errors import InputError
from ssp_core.files import read_mapping, read_text
from ssp_core.hashing import sha256_json
from ssp_core.vocabulary import (
    CONFLICTS,
    DOMAINS,
    LAT_ACTIONS,
    LON_ACTIONS,
    MOTIONS,
    OBJECTS,
    PHASES,
    POSITIONS,
)
from ssp_eval.data import json_fields
from ssp_eval.data.json_fields import Location

# Where the label times of a file come from: a plan by phase, or a grid on the clock.
BY_PHASE, BY_CLOCK = "phase", "clock"
# How a place is given: in seconds beside the event, or as a fraction of the phase.
_PHASE_VARIABLES = {"approach": "s", "trigger": "u", "conflict": "u", "resolution": "s"}


@dataclass(frozen=True)
class PhasePosition:
    """A label's place in its phase.

    Args:
        phase: one of approach, trigger, conflict, resolution.
        value: seconds before the trigger (approach) or after the resolution's start (resolution);
            the fraction of its phase, in (0, 1), in trigger and conflict.
    """

    phase: str
    value: float

    def __str__(self) -> str:
        return f"{self.phase} {_PHASE_VARIABLES[self.phase]}={self.value:.4g}"

    def to_json(self) -> dict[str, Any]:
        """As it stands in a labels file."""
        return {"phase": self.phase, _PHASE_VARIABLES[self.phase]: self.value}


def read_phase_position(label: dict[str, Any], place: Location, plan: str) -> PhasePosition | None:
    """The place of a label: there must be one if the plan is by phase, and none on a clock grid.

    Args:
        label: parsed.
        place: of the label, for messages.
        plan: of its file.

    Raises:
        InputError: it is missing, forbidden or no place.
    """
    where = place.at("at")
    if plan == BY_CLOCK:
        if "at" in label:
            raise where.error(
                "stands in a label on a clock grid",
                remedy='write "plan": "phase" at the top of the file, or leave it out',
            )
        return None
    if "at" not in label:
        raise where.error(
            "is missing", remedy='a label of a plan by phase says its place in it, "at": {…}'
        )
    found = json_fields.mapping(label["at"], where, ("phase",), ("s", "u"))
    phase = json_fields.choice(found["phase"], where.at("phase"), PHASES)
    key = _PHASE_VARIABLES[phase]
    json_fields.mapping(found, where, ("phase", key))
    value = json_fields.finite(found[key], where.at(key))
    if key == "u" and not 0.0 < value < 1.0:
        remedy = "give one between 0 and 1, both excluded"
        raise where.at(key).error("is no fraction of the phase", value, remedy)
    if key == "s" and value < 0.0:
        remedy = "give seconds before the trigger, or after the resolution's start"
        raise where.at(key).error("must not be negative", value, remedy)
    return PhasePosition(phase, value)


SCHEMA = "ssp.labels/1"
FILL_IN = "template: fill in"
# What a label can't be without.
_NEEDED = ("phase", "risk_visible", "lon_actions", "lat_actions")


def template_json(
    scenario: str,
    domain: str,
    event_version: str,
    times_s: Sequence[float],
    places: Sequence[PhasePosition] = (),
    risk_time_s: float | None = None,
) -> dict[str, Any]:
    """The content of a template.

    Args:
        scenario: name.
        domain: of METHOD 5.2.
        event_version: K* version, or a word that says that nobody knows it.
        times_s: clip times, rising.
        places: of a plan, one for each time; empty: the times lie on a clock grid.
        risk_time_s: where the plan knows it.
    """
    everywhere: Sequence[PhasePosition | None] = places or (None,) * len(times_s)
    return {
        **({"plan": BY_PHASE} if places else {}),
        "schema": SCHEMA,
        "scenario": scenario,
        "domain": domain,
        "event_version": event_version,
        "risk_time_s": risk_time_s,
        "first_frame_dynamics": False,
        "labels": [
            {
                "t_s": t_s,
                "phase": None if at is None else at.phase,
                "risk_visible": None,
                "objects": None,
                "position": None,
                "motion": None,
                "conflict": None,
                "lon_actions": [],
                "lat_actions": [],
                **({} if at is None else {"at": at.to_json()}),
            }
            for t_s, at in zip(times_s, everywhere, strict=True)
        ],
    }


def unfilled(value: object) -> list[str]:
    """Fields that are still to be filled in, by label; [] for what is no template.

    Args:
        value: the parsed content of a labels file, whatever it holds.
    """
    labels = value.get("labels") if isinstance(value, dict) else None
    if not isinstance(labels, list):
        return []
    waiting = [label for label in labels if isinstance(label, dict) and _is_blank(label)]
    if not waiting:
        return []
    return [
        f"labels[{i}].{key}"
        for i, label in enumerate(labels)
        if isinstance(label, dict)
        for key in _NEEDED
        if key in label and label[key] in (None, [])
    ]


def _is_blank(label: dict[str, Any]) -> bool:
    return any(key in label and label[key] is None for key in ("phase", "risk_visible"))


_KEYS = (
    "schema",
    "scenario",
    "domain",
    "event_version",
    "risk_time_s",
    "first_frame_dynamics",
    "labels",
)
LABEL_KEYS = (
    "t_s",
    "phase",
    "risk_visible",
    "objects",
    "position",
    "motion",
    "conflict",
    "lon_actions",
    "lat_actions",
)


@dataclass(frozen=True)
class Label:
    """What is true at one time of a clip; None marks a slot that can't be evaluated there.

    Args:
        t_s: clip time, s.
        phase: one of approach, trigger, conflict, resolution.
        risk_visible: whether the risk can be seen in the forward video by now.
        objects: classes of the relevant road users; ``()`` says that there is nobody.
        position: of the critical object, seen from the VUT.
        motion: of the critical object, seen from the VUT.
        conflict: state of the conflict.
        lon_actions: longitudinal actions that are right here, at least one.
        lat_actions: lateral actions that are right here, at least one.
        at: its place in the plan; None for labels on a clock grid.
    """

    t_s: float
    phase: str
    risk_visible: bool
    objects: tuple[str, ...] | None
    position: str | None
    motion: str | None
    conflict: str | None
    lon_actions: tuple[str, ...]
    lat_actions: tuple[str, ...]
    at: PhasePosition | None = None


@dataclass(frozen=True)
class Labels:
    """The labels of one scenario in one domain.

    Args:
        scenario: name of the scenario, such as ``cut_in``.
        domain: synthetic, simulation or physical.
        event_version: content hash of the K* that the clip realises.
        risk_time_s: clip time of risk onset, s; None: the first label with risk_visible.
        first_frame_dynamics: whether motion and conflict are evaluated at the earliest label.
        labels: at least one, times rising strictly.
        plan: where the times come from: ``phase``, a plan of METHOD 5.2b, or ``clock``, a grid.
    """

    scenario: str
    domain: str
    event_version: str
    risk_time_s: float | None
    first_frame_dynamics: bool
    labels: tuple[Label, ...]
    plan: str = BY_CLOCK

    @property
    def risk_onset_s(self) -> float:
        """t_r of METHOD 6.9: risk_time_s, else the time of the first label with risk_visible.

        Raises:
            ValueError: neither is there (a loaded file always has one).
        """
        if self.risk_time_s is not None:
            return self.risk_time_s
        for label in self.labels:
            if label.risk_visible:
                return label.t_s
        raise ValueError("labels without risk onset")


def load_labels(path: str | Path) -> Labels:
    """The labels of a JSON file, or of a YAML file with the same keys.

    A text that parses as JSON is read as JSON whatever its name (YAML reads some JSON numbers as
    words); otherwise a name that ends in ``.json`` is refused and any other is read as YAML.

    Raises:
        InputError: the file can't be read or parsed, or parse_labels refuses it.
    """
    return parse_labels_text(read_text(path), path)


def parse_labels_text(text: str, path: str | Path) -> Labels:
    """The labels of a file that was read already, see load_labels.

    Args:
        text: what it holds.
        path: of the file.

    Raises:
        InputError: see load_labels.
    """
    try:
        value = json_fields.parse_json(text.removeprefix("\ufeff"), Location(path))
    except InputError:
        if Path(path).suffix.lower() == ".json":
            raise
        value = read_mapping(path)
    return parse_labels(value, path)


def parse_labels(value: object, file: str | Path) -> Labels:
    """Labels from the parsed content of a labels file.

    Args:
        value: what the JSON or YAML text holds.
        file: name for error messages.

    Raises:
        InputError: the first thing that is wrong, with its field path (METHOD 5.6): unknown
            schema, missing or unknown keys, a value outside its vocabulary or of the wrong type,
            times that don't rise, an empty action set, no labels, no risk onset, a place in a plan
            that is missing or that no plan has; or it is a template that isn't filled in.
    """
    place = Location(file)
    found = json_fields.mapping(value, place, _KEYS, ("plan",))
    json_fields.choice(found["schema"], place.at("schema"), (SCHEMA,))
    _refuse_template(found, file)
    risk = found["risk_time_s"]
    plan = json_fields.choice(found.get("plan", BY_CLOCK), place.at("plan"), (BY_PHASE, BY_CLOCK))
    result = Labels(
        scenario=_name(found["scenario"], place.at("scenario")),
        domain=json_fields.choice(found["domain"], place.at("domain"), DOMAINS),
        event_version=_name(found["event_version"], place.at("event_version")),
        risk_time_s=None if risk is None else json_fields.finite(risk, place.at("risk_time_s")),
        first_frame_dynamics=json_fields.boolean(
            found["first_frame_dynamics"], place.at("first_frame_dynamics")
        ),
        labels=_labels(found["labels"], place.at("labels"), plan),
        plan=plan,
    )
    if risk is None and not any(label.risk_visible for label in result.labels):
        raise place.at("risk_time_s").error(
            "is null, and no label has risk_visible: true",
            remedy="a labels file must say when the risk begins, in one way or the other",
        )
    return result


def _refuse_template(value: object, file: str | Path) -> None:
    waiting = unfilled(value)
    if waiting:
        raise InputError(
            FILL_IN,
            file=file,
            field=waiting[0],
            remedy=f"{len(waiting)} fields are empty; `ssp labels sheet` shows the frames",
        )


def _labels(value: object, place: Location, plan: str) -> tuple[Label, ...]:
    items = json_fields.items(value, place)
    labels = tuple(_label(item, place.at(i), plan) for i, item in enumerate(items))
    if not labels:
        raise place.error("must hold at least one label")
    for i, (before, after) in enumerate(pairwise(labels), start=1):
        if after.t_s <= before.t_s:
            where = place.at(i).at("t_s")
            raise where.error(
                "must rise strictly from label to label",
                after.t_s,
                remedy=f"the label before has {before.t_s!r}",
            )
    return labels


def _label(value: object, place: Location, plan: str) -> Label:
    found = json_fields.mapping(value, place, LABEL_KEYS, ("at",))

    def optional(key: str, vocabulary: tuple[str, ...]) -> str | None:
        given = found[key]
        return None if given is None else json_fields.choice(given, place.at(key), vocabulary)

    objects = found["objects"]
    return Label(
        t_s=json_fields.finite(found["t_s"], place.at("t_s")),
        phase=json_fields.choice(found["phase"], place.at("phase"), PHASES),
        risk_visible=json_fields.boolean(found["risk_visible"], place.at("risk_visible")),
        objects=None
        if objects is None
        else json_fields.choices(objects, place.at("objects"), OBJECTS),
        position=optional("position", POSITIONS),
        motion=optional("motion", MOTIONS),
        conflict=optional("conflict", CONFLICTS),
        lon_actions=_actions(found["lon_actions"], place.at("lon_actions"), LON_ACTIONS),
        lat_actions=_actions(found["lat_actions"], place.at("lat_actions"), LAT_ACTIONS),
        at=read_phase_position(found, place, plan),
    )


def _name(value: object, place: Location) -> str:
    text = json_fields.string(value, place)
    if not text.strip():
        raise place.error("must not be blank")
    return text


def _actions(value: object, place: Location, vocabulary: tuple[str, ...]) -> tuple[str, ...]:
    actions = json_fields.choices(value, place, vocabulary)
    if not actions:
        raise place.error("must not be empty", remedy=f"known are {', '.join(vocabulary)}")
    return actions


def labels_to_json(labels: Labels) -> dict[str, Any]:
    """The content of a labels file (METHOD 5.2), ready for json.dump or files.write_json.

    A clock grid isn't named, since a file without a plan has one: what says the same has one hash.
    """
    plan = {} if labels.plan == BY_CLOCK else {"plan": labels.plan}
    return {
        **plan,
        "schema": SCHEMA,
        "scenario": labels.scenario,
        "domain": labels.domain,
        "event_version": labels.event_version,
        "risk_time_s": labels.risk_time_s,
        "first_frame_dynamics": labels.first_frame_dynamics,
        "labels": [_label_json(label) for label in labels.labels],
    }


def labels_version(labels: Labels) -> str:
    """Hash of what labels say, however their file is written."""
    return sha256_json(labels_to_json(labels))


def _label_json(label: Label) -> dict[str, Any]:
    return {
        "t_s": label.t_s,
        "phase": label.phase,
        "risk_visible": label.risk_visible,
        "objects": None if label.objects is None else list(label.objects),
        "position": label.position,
        "motion": label.motion,
        "conflict": label.conflict,
        "lon_actions": list(label.lon_actions),
        "lat_actions": list(label.lat_actions),
        **({} if label.at is None else {"at": label.at.to_json()}),
    }


_TOLERANCE = 1e-9


@dataclass(frozen=True)
class LabelComparison:
    """What several recordings' labels allow.

    Args:
        domains: how many recordings there are; one alone has nobody to be compared with.
        comparable: whether a difference between their scores can be one between domains.
        aligned: whether their labels lie at the same places of the phases.
        text: how many labels each has per phase, and what keeps them apart; for people.
    """

    domains: int
    comparable: bool
    aligned: bool
    text: str

    @property
    def line(self) -> str:
        """The text with its verdict, for people."""
        if self.domains > 1 and not self.comparable:
            return f"{self.text}: not comparable"
        if self.domains > 1 and not self.aligned:
            return f"{self.text}: not phase-aligned"
        return self.text


def phase_counts(labels: Labels) -> dict[str, int]:
    """How many labels each phase has."""
    return {phase: sum(label.phase == phase for label in labels.labels) for phase in PHASES}


def counts_text(counts: Mapping[str, int]) -> str:
    """``3/1/4/1``: labels in approach, trigger, conflict and resolution."""
    return "/".join(str(counts[phase]) for phase in PHASES)


def compare_labels(by_name: Mapping[str, Labels]) -> LabelComparison:
    """Whether recordings of one event are comparable at label level (METHOD 5.2b).

    Args:
        by_name: labels of each recording, by its domain or another name.
    """
    count = len(by_name)
    counts = {name: counts_text(phase_counts(labels)) for name, labels in by_name.items()}
    told = ", ".join(f"{name} {text}" for name, text in counts.items())
    plans = {labels.plan for labels in by_name.values()}
    if len(plans) > 1:
        parts = [f"{name} by {labels.plan}" for name, labels in by_name.items()]
        text = f"{told}; label times differ in kind: {', '.join(parts)}"
        return LabelComparison(count, False, False, text)
    if plans != {BY_PHASE}:
        same = len(set(counts.values())) <= 1
        return LabelComparison(count, same, False, told)
    places = {name: [label.at for label in labels.labels] for name, labels in by_name.items()}
    first = next(iter(places.values()))
    differing = [name for name, other in places.items() if not _are_equal(first, other)]
    if not differing:
        return LabelComparison(count, True, True, told)
    if len(set(counts.values())) == 1:
        told = f"{told}, at other places of the phases in {', '.join(differing)}"
    return LabelComparison(count, False, False, told)


def compare_by_scenario(
    labelled: Iterable[tuple[str, str, Labels]],
) -> dict[str, LabelComparison]:
    """What the labels of each scenario allow.

    Args:
        labelled: scenario, domain and labels of recordings; of several with the same scenario and
            domain the first counts.
    """
    found: dict[str, dict[str, Labels]] = {}
    for scenario, domain, labels in labelled:
        found.setdefault(scenario, {}).setdefault(domain, labels)
    return {scenario: compare_labels(found[scenario]) for scenario in sorted(found)}


def _are_equal(one: list[PhasePosition | None], other: list[PhasePosition | None]) -> bool:
    return len(one) == len(other) and all(
        a is not None
        and b is not None
        and a.phase == b.phase
        and math.isclose(a.value, b.value, rel_tol=0.0, abs_tol=_TOLERANCE)
        for a, b in zip(one, other, strict=True)
    )
