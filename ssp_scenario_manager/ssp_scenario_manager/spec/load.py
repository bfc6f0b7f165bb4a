"""Reading K* files, and the version of a K*: the hash of what it says, not of how it is written."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ssp_core.errors import InputError
from ssp_core.files import parse_model, read_mapping
from ssp_core.hashing import sha256_json
from ssp_scenario_manager.site import find_shipped
from ssp_scenario_manager.spec.model import Event

# A K* has some hundred lines; what is much larger is none, and would keep a YAML parser busy.
MAX_EVENT_BYTES = 256 << 10
# Lists that are sets: their order says nothing.
_SETS = (
    ("interaction", "longitudinal_responses"),
    ("interaction", "lateral_responses"),
)
OLD_SCHEMA = "ssp.event/1"


def read_event_file(name_or_path: str) -> tuple[dict[str, Any], Path]:
    """The mapping in a K* file, unchecked, and the file.

    Raises:
        InputError: there is no such event, or the file is too large or no mapping.
    """
    path = find_shipped(name_or_path, "event")
    try:
        size = path.stat().st_size
    except (OSError, ValueError):
        size = 0  # read_mapping says what is wrong
    if size > MAX_EVENT_BYTES:
        raise InputError(
            f"is larger than {MAX_EVENT_BYTES >> 10} KiB", file=path, remedy="name a K* file"
        )
    return read_mapping(path), path


def load_event(name_or_path: str) -> tuple[Event, str]:
    """A K* by the name of a shipped one or by file, and its version.

    Only the form is checked here; `spec.checks.check_event` holds all checks (METHOD 1).

    Raises:
        InputError: there is no such event or the file is not valid; the first failure with its
            field, and how many more there are.
    """
    value, path = read_event_file(name_or_path)
    refuse_old(value, path)
    event = parse_model(Event, value, path)
    return event, event_version(event)


def refuse_old(value: Mapping[str, Any], path: Path) -> None:
    """Raises where a file is of the form that had no identity fields.

    Raises:
        InputError: it is; the remedy is the command that moves it over.
    """
    if value.get("schema") == OLD_SCHEMA:
        raise InputError(
            "is of an older form, whose part T says neither what the source shows nor what "
            "must be equal in all domains",
            file=path,
            field="schema",
            value=OLD_SCHEMA,
            remedy=f"`ssp spec check {path} --migrate NEW.event.yaml` writes the new form",
        )


def canonical(event: Event) -> dict[str, Any]:
    """The one mapping of everything that says the same: defaults filled in, sets in order."""
    value: dict[str, Any] = _plain(event.model_dump(mode="json", by_alias=True))
    for part, name in _SETS:
        value[part][name] = sorted(value[part][name])
    for field in value["topology"].values():
        for name in ("value", "varies"):
            if isinstance(field[name], list):
                field[name] = sorted(field[name])
    for participant in value["participants"].values():
        if participant["intent"] is None:
            del participant["intent"]
    return value


def event_version(event: Event) -> str:
    """Content hash of a K* over its canonical form (METHOD 1)."""
    return sha256_json(canonical(event))


def _plain(value: Any) -> Any:
    """Without negative zeros, which are equal to 0 and would be written otherwise."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_plain(item) for item in value]
    return value + 0.0 if isinstance(value, float) else value
