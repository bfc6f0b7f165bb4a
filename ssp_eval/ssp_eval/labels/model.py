"""The labels file (METHOD 5.2, 5.2b): typed model, strict loading, writing."""

from __future__ import annotations

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
from ssp_eval import strict
from ssp_eval.labels.place import BY_CLOCK, BY_PHASE, At, read_at
from ssp_eval.labels.template import FILL_IN, SCHEMA, unfilled
from ssp_eval.strict import Place

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
    at: At | None = None


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
        value = strict.parse_json(text.removeprefix("\ufeff"), Place(path))
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
    place = Place(file)
    found = strict.mapping(value, place, _KEYS, ("plan",))
    strict.choice(found["schema"], place.at("schema"), (SCHEMA,))
    _refuse_template(found, file)
    risk = found["risk_time_s"]
    plan = strict.choice(found.get("plan", BY_CLOCK), place.at("plan"), (BY_PHASE, BY_CLOCK))
    result = Labels(
        scenario=_name(found["scenario"], place.at("scenario")),
        domain=strict.choice(found["domain"], place.at("domain"), DOMAINS),
        event_version=_name(found["event_version"], place.at("event_version")),
        risk_time_s=None if risk is None else strict.finite(risk, place.at("risk_time_s")),
        first_frame_dynamics=strict.boolean(
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


def _labels(value: object, place: Place, plan: str) -> tuple[Label, ...]:
    items = strict.items(value, place)
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


def _label(value: object, place: Place, plan: str) -> Label:
    found = strict.mapping(value, place, LABEL_KEYS, ("at",))

    def optional(key: str, vocabulary: tuple[str, ...]) -> str | None:
        given = found[key]
        return None if given is None else strict.choice(given, place.at(key), vocabulary)

    objects = found["objects"]
    return Label(
        t_s=strict.finite(found["t_s"], place.at("t_s")),
        phase=strict.choice(found["phase"], place.at("phase"), PHASES),
        risk_visible=strict.boolean(found["risk_visible"], place.at("risk_visible")),
        objects=None if objects is None else strict.choices(objects, place.at("objects"), OBJECTS),
        position=optional("position", POSITIONS),
        motion=optional("motion", MOTIONS),
        conflict=optional("conflict", CONFLICTS),
        lon_actions=_actions(found["lon_actions"], place.at("lon_actions"), LON_ACTIONS),
        lat_actions=_actions(found["lat_actions"], place.at("lat_actions"), LAT_ACTIONS),
        at=read_at(found, place, plan),
    )


def _name(value: object, place: Place) -> str:
    text = strict.string(value, place)
    if not text.strip():
        raise place.error("must not be blank")
    return text


def _actions(value: object, place: Place, vocabulary: tuple[str, ...]) -> tuple[str, ...]:
    actions = strict.choices(value, place, vocabulary)
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
