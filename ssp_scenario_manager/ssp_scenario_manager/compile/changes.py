"""Changes on site: one field of a run by its path, and what the log explains of an executed run.

A field's path is its dotted name, with ``[i]`` for an item of a list: ``limits.speed_mps``,
``triggers[0].condition.below_m``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from ssp_core.errors import InputError
from ssp_core.files.reading import parse_model
from ssp_core.files.reading import parse_value as parse_yaml
from ssp_core.run_file.model import RunSpec
from ssp_scenario_manager.compile.task import as_live
from ssp_scenario_manager.event_spec.fields import get, has, join, leaves, put, split
from ssp_scenario_manager.event_spec.log import Record

# What belongs to one run, and what says which versions and what kind of site it was made for: never
# a change on site.
OF_THE_RUN = frozenset(
    {"run_id", "seed", "mode", "session_token", "declaring", "camera.renderer", "plant"}
)
LINKS = frozenset(
    {
        "schema",
        "compiler",
        "scenario",
        "event_version",
        "task_version",
        "site_version",
        "domain",
        "stand_in",
    }
)
# What the event is, by its K* (parts C and I): with another value it would be another event.
OF_THE_EVENT = frozenset({"interaction", "observable", "initiator", "thresholds", "passing"})

_ABSENT = object()


@dataclass(frozen=True, slots=True)
class Difference:
    """A field that was executed otherwise than the compiled task and the log say.

    Args:
        compiled: value after all logged changes; None also where there is no such field.
        executed: value that was executed; None also where there is no such field.
    """

    field: str
    compiled: Any
    executed: Any


def run_mapping(run: RunSpec) -> dict[str, Any]:
    """Return the run as JSON values, every default filled in."""
    mapping: dict[str, Any] = run.model_dump(mode="json", by_alias=True)
    # Files leave these out where nobody gave them.
    mapping.setdefault("datum", None)
    mapping.setdefault("session_token", "")
    mapping.setdefault("declaring", [])
    mapping.setdefault("plant", run.plant)
    mapping["limits"].setdefault("stop_reaction_s", run.limits.stop_reaction_s)
    return mapping


def value_at(run: RunSpec, field: str, file: str | Path | None = None) -> Any:
    """Return the JSON value of a field.

    Raises:
        InputError: the run has no such field.
    """
    mapping = run_mapping(run)
    if has(mapping, field):
        return get(mapping, field)
    whole = [split(leaf) for leaf, _ in leaves(mapping)]
    fields = {join(parts[:end]): None for parts in whole for end in range(1, len(parts) + 1)}
    near = get_close_matches(field, fields, n=3, cutoff=0.5)
    raise InputError(
        "is no field of the run",
        file=file,
        field=field,
        remedy=f"did you mean {' or '.join(near)}?" if near else "its fields stand in run.yaml",
    )


def with_value(run: RunSpec, field: str, value: Any, file: str | Path | None = None) -> RunSpec:
    """Return the run with another value in one field, validated whole.

    Raises:
        InputError: the run has no such field, or the value isn't one for it.
    """
    value_at(run, field, file)
    mapping = run_mapping(run)
    put(mapping, field, value)
    return parse_model(RunSpec, mapping, file or "run")


def _outermost(field: str) -> str:
    """Return the name of the field of the run that a field stands in."""
    return re.split(r"[.\[]", field, maxsplit=1)[0]


def check_changeable(field: str) -> None:
    """Refuse a field that no change on site may touch, with an InputError."""
    name = _outermost(field)
    if OF_THE_RUN & {name, field}:
        raise InputError(
            "is a run's own and no change on site", field=field, remedy="`ssp run` sets it"
        )
    if name in LINKS:
        raise InputError(
            "says what the task was made from, and can't be changed on site",
            field=field,
            remedy="compile the event again",
        )
    if name in OF_THE_EVENT:
        raise InputError(
            "is the event's own by its K*, and can't be changed on site",
            field=field,
            remedy="make another version of the K* and compile that",
        )


def parse_value(run: RunSpec, field: str, text: str, file: str | Path | None = None) -> Any:
    """Read the text typed for a field as the model of runs does (``15`` is 15.0 m/s there).

    Returns:
        The JSON value.

    Raises:
        InputError: there is no such field, or the text gives no value for it.
    """
    value_at(run, field, file)
    try:
        value = parse_yaml(text, file or "run")
    except InputError as error:
        raise InputError(
            "is no YAML value", field=field, value=text, remedy="write the value as in run.yaml"
        ) from error
    try:
        return value_at(with_value(run, field, value, file), field, file)
    except InputError:
        # YAML takes words such as `no` for something else; a field of text takes them as typed.
        if isinstance(value, str):
            raise
        try:
            return value_at(with_value(run, field, text, file), field, file)
        except InputError:
            pass
        raise


def apply_record(run: RunSpec, record: Record, file: str | Path | None = None) -> RunSpec:
    """Return the run after one ``site_change``.

    Raises:
        InputError: it changes no field of the run, or from another value than the run has.
    """
    if record.field is None:
        raise InputError(
            "names no field",
            file=file,
            value=record.reason,
            remedy="name the field that was changed",
        )
    check_changeable(record.field)
    before = value_at(run, record.field, file)
    if not same_value(before, record.old):
        raise InputError(
            f"was {before!r} before this change, and the entry says otherwise",
            file=file,
            field=record.field,
            value=record.old,
            remedy="enter the value that the run had",
        )
    return with_value(run, record.field, record.new, file)


def explained(run: RunSpec, records: Iterable[Record], file: str | Path | None = None) -> RunSpec:
    """Return the compiled run after every ``site_change`` of its log, in order.

    Raises:
        InputError: a change doesn't fit what was before it.
    """
    for record in records:
        if record.kind == "site_change":
            run = apply_record(run, record, file)
    return run


def differences(compiled: RunSpec, executed: RunSpec) -> list[Difference]:
    """Return the fields in which two runs differ, but for a run's own (id, seed, mode).

    A live run never has what only a simulated world adds (``compile.live.as_live``).
    """
    if executed.mode == "live" and compiled.domain == "physical":
        compiled = as_live(compiled)
    before, after = _fields(compiled), _fields(executed)
    changes = []
    for field in dict.fromkeys([*before, *after]):
        old, new = before.get(field, _ABSENT), after.get(field, _ABSENT)
        if OF_THE_RUN & {_outermost(field), field} or same_value(old, new):
            continue
        changes.append(
            Difference(field, None if old is _ABSENT else old, None if new is _ABSENT else new)
        )
    return changes


def _fields(run: RunSpec) -> dict[str, Any]:
    """Return the run's values by field; the fence is one, since its corners belong together."""
    mapping = run_mapping(run)
    whole = {"geofence": mapping.pop("geofence")}
    return {**dict(leaves(mapping)), **whole}


def same_value(one: Any, other: Any) -> bool:
    """Tell whether JSON values are equal; a boolean is no number, and 15 is 15.0."""
    if isinstance(one, bool) or isinstance(other, bool):
        return one is other
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(same_value, one, other))
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(same_value(one[k], other[k]) for k in one)
    return bool(one == other)
