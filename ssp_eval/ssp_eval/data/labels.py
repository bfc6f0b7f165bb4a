"""The labels file (METHOD 5.2, 5.2b): model, strict loading, writing, templates, comparison."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, RootModel, Strict

from ssp_core.errors import InputError
from ssp_core.files.reading import parse_model, parse_value, read_text
from ssp_core.hashing import sha256_json
from ssp_core.run_file.quantities import quantity_of
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

# Where the label times of a file come from: a plan by phase, or a grid on the clock.
BY_PHASE, BY_CLOCK = "phase", "clock"
# How a place is given: in seconds beside the event, or as a fraction of the phase.
_PHASE_VARIABLES = {"approach": "s", "trigger": "u", "conflict": "u", "resolution": "s"}


def one_of(vocabulary: Sequence[str]) -> AfterValidator:
    """Return words of a closed vocabulary alone."""

    def check(word: str) -> str:
        if word not in vocabulary:
            raise ValueError(f"is outside the vocabulary; known: {', '.join(vocabulary)}")
        return word

    return AfterValidator(check)


def _position_of(value: Any) -> Any:
    """Return a place as a file has it, ``{"phase": "conflict", "u": 0.5}``."""
    if not isinstance(value, dict):
        return value
    key = _PHASE_VARIABLES.get(str(value.get("phase")), "s or u")
    if value.keys() != {"phase", key}:
        raise ValueError(f"must have the keys phase (of {', '.join(PHASES)}) and {key}")
    return {"phase": value["phase"], "value": value[key]}


# A text, flag or number that isn't made of another kind of value.
Text = Annotated[str, Strict()]
Flag = Annotated[bool, Strict()]
Number = Annotated[float, Strict(), Field(allow_inf_nan=False)]
# Within a day of a clip's start.
ClipTime = Annotated[Number, AfterValidator(quantity_of("t_s").within)]
Name = Annotated[Text, Field(pattern=r"\S")]
CLOSED = ConfigDict(extra="forbid")


def once(words: tuple[str, ...]) -> tuple[str, ...]:
    """Return the words in their order; repeated ones count once."""
    return tuple(dict.fromkeys(words))


@dataclass(frozen=True)
class PhasePosition:
    """A label's place in its phase.

    Args:
        phase: one of approach, trigger, conflict, resolution.
        value: seconds before the trigger (approach) or after the resolution's start (resolution);
            the fraction of its phase, in (0, 1), in trigger and conflict.
    """

    phase: Annotated[str, one_of(PHASES)]
    value: ClipTime

    def __str__(self) -> str:
        return f"{self.phase} {_PHASE_VARIABLES[self.phase]}={self.value:.4g}"

    def to_json(self) -> dict[str, Any]:
        """Return the position as a labels file has it."""
        return {"phase": self.phase, _PHASE_VARIABLES[self.phase]: self.value}


def _in_phase(place: PhasePosition | None) -> PhasePosition | None:
    if place is None:
        raise ValueError("is no place: leave it out on a clock grid")
    if _PHASE_VARIABLES[place.phase] == "u" and not 0.0 < place.value < 1.0:
        raise ValueError("is no fraction of the phase: give one between 0 and 1, both excluded")
    if place.value < 0.0:
        raise ValueError(
            "must not be negative: give seconds before the trigger, or after the resolution's start"
        )
    return place


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
    """Return the content of a template.

    Args:
        scenario: name of the event.
        domain: of METHOD 5.2.
        event_version: K* version, or a word for an unknown one.
        times_s: clip times, rising.
        places: of a plan, one for each time; empty: the times lie on a clock grid.
        risk_time_s: where the plan knows it.
    """
    everywhere: Sequence[PhasePosition | None] = places or (None,) * len(times_s)
    blank: dict[str, Any] = dict.fromkeys(LABEL_KEYS) | {"lon_actions": [], "lat_actions": []}
    labels = [
        {**blank, "t_s": t_s}
        if at is None
        else {**blank, "t_s": t_s, "phase": at.phase, "at": at.to_json()}
        for t_s, at in zip(times_s, everywhere, strict=True)
    ]
    return {
        **({"plan": BY_PHASE} if places else {}),
        "schema": SCHEMA,
        "scenario": scenario,
        "domain": domain,
        "event_version": event_version,
        "risk_time_s": risk_time_s,
        "first_frame_dynamics": False,
        "labels": labels,
    }


def unfilled(value: object) -> list[str]:
    """Return the fields that are still to be filled in, by label; [] for what is no template.

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


@dataclass(frozen=True)
class Label:
    """The truth at one time of a clip; None marks a slot that can't be evaluated there.

    Args:
        t_s: clip time, s.
        phase: one of approach, trigger, conflict, resolution.
        risk_visible: whether the risk can be seen in the forward video by now.
        objects: classes of the relevant road users; ``()`` says that there are none.
        position: of the critical object, seen from the VUT.
        motion: of the critical object, seen from the VUT.
        lon_actions: longitudinal actions that are right here, at least one.
        lat_actions: lateral actions that are right here, at least one.
        at: its place in the plan; None for labels on a clock grid.
    """

    t_s: ClipTime
    phase: Annotated[str, one_of(PHASES)]
    risk_visible: Flag
    objects: Annotated[tuple[Annotated[str, one_of(OBJECTS)], ...], AfterValidator(once)] | None
    position: Annotated[str, one_of(POSITIONS)] | None
    motion: Annotated[str, one_of(MOTIONS)] | None
    conflict: Annotated[str, one_of(CONFLICTS)] | None
    lon_actions: Annotated[
        tuple[Annotated[str, one_of(LON_ACTIONS)], ...], Field(min_length=1), AfterValidator(once)
    ]
    lat_actions: Annotated[
        tuple[Annotated[str, one_of(LAT_ACTIONS)], ...], Field(min_length=1), AfterValidator(once)
    ]
    at: Annotated[
        PhasePosition | None, BeforeValidator(_position_of), AfterValidator(_in_phase)
    ] = None

    __pydantic_config__: ClassVar[ConfigDict] = CLOSED


LABEL_KEYS = tuple(item.name for item in fields(Label) if item.name != "at")


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

    scenario: Name
    domain: Annotated[str, one_of(DOMAINS)]
    event_version: Name
    risk_time_s: ClipTime | None
    first_frame_dynamics: Flag
    labels: Annotated[tuple[Label, ...], Field(min_length=1)]
    plan: Annotated[str, one_of((BY_PHASE, BY_CLOCK))] = BY_CLOCK

    __pydantic_config__: ClassVar[ConfigDict] = CLOSED

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


class _LabelsFile(RootModel[Labels]):
    """``ssp.labels/1`` without its schema."""


def load_labels(path: str | Path) -> Labels:
    """Return the labels of a JSON file, or of a YAML file with the same keys.

    Raises:
        InputError: the file can't be read or parsed, or parse_labels refuses it.
    """
    return parse_labels_text(read_text(path), path)


def parse_labels_text(text: str, path: str | Path) -> Labels:
    """Return the labels of a file that was read already, see load_labels."""
    return parse_labels(parse_value(text.removeprefix("\ufeff"), path), path)


def parse_labels(value: object, file: str | Path) -> Labels:
    """Return the labels from the parsed content of a labels file.

    Raises:
        InputError: something is wrong (METHOD 5.6), with its field path: unknown schema, missing
            or unknown keys, a value outside its vocabulary or of the wrong type, times that don't
            rise, an empty action set, no labels, no risk onset, a place in a plan that is missing
            or that no plan has; or it is a template that isn't filled in.
    """
    if not isinstance(value, dict):
        raise InputError(
            "must hold a mapping at its top",
            file=file,
            remedy="write the fields of a labels file; `ssp labels new` makes one",
        )
    if value.get("schema") != SCHEMA:
        raise InputError(
            f"must be {SCHEMA}",
            file=file,
            field="schema",
            value=value.get("schema"),
            remedy=f"write {SCHEMA}; `ssp labels new` makes such a file",
        )
    if waiting := unfilled(value):
        remedy = f"{len(waiting)} fields are empty; `ssp labels sheet` shows the frames"
        raise InputError(FILL_IN, file=file, field=waiting[0], remedy=remedy)
    content = {key: inner for key, inner in value.items() if key != "schema"}
    labels = parse_model(_LabelsFile, content, file).root
    for i, (before, after) in enumerate(pairwise(labels.labels), start=1):
        if after.t_s <= before.t_s:
            raise InputError(
                "must rise strictly from label to label",
                file=file,
                field=f"labels[{i}].t_s",
                value=after.t_s,
                remedy=f"the label before has {before.t_s!r}",
            )
    for i, label in enumerate(labels.labels):
        if (label.at is None) != (labels.plan == BY_CLOCK):
            problem, remedy = (
                ("is missing", 'a label of a plan by phase says its place in it, "at": {…}')
                if label.at is None
                else (
                    "stands in a label on a clock grid",
                    'write "plan": "phase" at the top of the file, or leave it out',
                )
            )
            raise InputError(problem, file=file, field=f"labels[{i}].at", remedy=remedy)
    if labels.risk_time_s is None and not any(label.risk_visible for label in labels.labels):
        raise InputError(
            "is null, and no label has risk_visible: true",
            file=file,
            field="risk_time_s",
            remedy="a labels file must say when the risk begins, in one way or the other",
        )
    return labels


def labels_to_json(labels: Labels) -> dict[str, Any]:
    """Return the content of a labels file (METHOD 5.2), ready for json.dump or files.write_json.

    A clock grid isn't named, since a file without a plan has one: what says the same has one hash.
    """
    content = {item.name: getattr(labels, item.name) for item in fields(labels)}
    if labels.plan == BY_CLOCK:
        del content["plan"]
    return {**content, "schema": SCHEMA, "labels": [_label_json(label) for label in labels.labels]}


def labels_version(labels: Labels) -> str:
    """Hash of what labels say, however their file is written."""
    return sha256_json(labels_to_json(labels))


def _label_json(label: Label) -> dict[str, Any]:
    content = {
        key: list(value) if isinstance(value := getattr(label, key), tuple) else value
        for key in LABEL_KEYS
    }
    return content if label.at is None else {**content, "at": label.at.to_json()}


_TOLERANCE = 1e-9


@dataclass(frozen=True)
class LabelComparison:
    """The comparison of several recordings' labels.

    Args:
        domains: how many recordings there are; a single one has no other to be compared with.
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
    """Count the labels of each phase."""
    return {phase: sum(label.phase == phase for label in labels.labels) for phase in PHASES}


def counts_text(counts: Mapping[str, int]) -> str:
    """Return labels in approach, trigger, conflict and resolution as ``3/1/4/1``."""
    return "/".join(str(counts[phase]) for phase in PHASES)


def compare_labels(by_name: Mapping[str, Labels]) -> LabelComparison:
    """Tell whether recordings of one event are comparable at label level (METHOD 5.2b).

    Args:
        by_name: labels of each recording, by its domain or another name.
    """
    count = len(by_name)
    counts = {name: counts_text(phase_counts(labels)) for name, labels in by_name.items()}
    description = ", ".join(f"{name} {text}" for name, text in counts.items())
    plans = {labels.plan for labels in by_name.values()}
    if len(plans) > 1:
        parts = [f"{name} by {labels.plan}" for name, labels in by_name.items()]
        text = f"{description}; label times differ in kind: {', '.join(parts)}"
        return LabelComparison(count, False, False, text)
    if plans != {BY_PHASE}:
        same = len(set(counts.values())) <= 1
        return LabelComparison(count, same, False, description)
    places = {name: [label.at for label in labels.labels] for name, labels in by_name.items()}
    first = next(iter(places.values()))
    differing = [name for name, other in places.items() if not _are_equal(first, other)]
    if not differing:
        return LabelComparison(count, True, True, description)
    if len(set(counts.values())) == 1:
        description = f"{description}, at other places of the phases in {', '.join(differing)}"
    return LabelComparison(count, False, False, description)


def compare_by_scenario(
    labelled: Iterable[tuple[str, str, Labels]],
) -> dict[str, LabelComparison]:
    """Compare the labels of each scenario.

    Args:
        labelled: scenario, domain and labels of recordings; of several with the same scenario and
            domain the first counts.
    """
    by_scenario: dict[str, dict[str, Labels]] = {}
    for scenario, domain, labels in labelled:
        by_scenario.setdefault(scenario, {}).setdefault(domain, labels)
    return {scenario: compare_labels(by_scenario[scenario]) for scenario in sorted(by_scenario)}


def _are_equal(one: list[PhasePosition | None], other: list[PhasePosition | None]) -> bool:
    return len(one) == len(other) and all(
        a is not None
        and b is not None
        and a.phase == b.phase
        and math.isclose(a.value, b.value, rel_tol=0.0, abs_tol=_TOLERANCE)
        for a, b in zip(one, other, strict=True)
    )
