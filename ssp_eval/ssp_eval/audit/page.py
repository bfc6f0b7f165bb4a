"""The audit as one page: verdicts, phase-aligned frames, phases, properties, coverage, log."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from markupsafe import Markup

from ssp_core import __version__
from ssp_eval.audit import frames
from ssp_eval.audit.axis import phase_axis
from ssp_eval.audit.judge import Judged
from ssp_eval.audit.model import Audit, PropertyEntry, RecordingEntry
from ssp_eval.audit.reasons import TABLE
from ssp_eval.recordings.properties import FIELDS, TOPOLOGY
from ssp_eval.templates import templates

_HERE = Path(__file__).parent
_REPORT_STYLE = _HERE.parent / "report" / "style.css"
_FACTS = {
    "time_gap_s": ("time gap at the conflict point", "s"),
    "min_ttc_s": ("smallest TTC, trigger to resolution", "s"),
    "min_distance_m": ("smallest distance", "m"),
    "trigger_gap_m": ("gap at the trigger", "m"),
    "vut_speed_at_trigger_mps": ("VUT's speed at the trigger", "m/s"),
    "ot_speed_at_trigger_mps": ("OT's speed at the trigger", "m/s"),
    "vut_speed_at_conflict_mps": ("VUT's speed at the conflict", "m/s"),
    "ot_speed_at_conflict_mps": ("OT's speed at the conflict", "m/s"),
}


@dataclass(frozen=True)
class PartRow:
    """One part of a mandatory property in the three recordings.

    Args:
        name: of the part, empty where the field has one part only.
        cells: per recording its words and how they compare: same, other, or unknown.
    """

    name: str
    cells: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class FieldRows:
    """A mandatory property."""

    name: str
    weight: float
    parts: tuple[PartRow, ...]
    how: tuple[str, ...]


def field_rows(audit: Audit) -> list[FieldRows]:
    """The table of properties, every field of KPR with its parts."""
    rows = []
    for field in FIELDS:
        entries = [recording.properties[field] for recording in audit.recordings]
        varying = {part for recording in audit.recordings for part in recording.varying}
        apart = varying if field == TOPOLOGY else set()
        names = dict.fromkeys(
            name for entry in entries for name in entry.words or {} if name not in apart
        )
        parts = [
            PartRow(
                name.replace("_", " ") if len(names) > 1 else "",
                tuple(_cell(recording, field, name) for recording in audit.recordings),
            )
            for name in names
        ]
        if not parts:
            cells = ((_lacking(entry), "unknown") for entry in entries)
            parts = [PartRow("", tuple(cells))]
        rows.append(
            FieldRows(
                field.replace("_", " "),
                audit.weights[field],
                tuple(parts),
                tuple(entry.how for entry in entries),
            )
        )
    return rows


def _cell(recording: RecordingEntry, field: str, part: str) -> tuple[str, str]:
    entry = recording.properties[field]
    if entry.words is None:
        return _lacking(entry), "unknown"
    words = entry.words.get(part, ["–"])
    digits = len(words) > 2 and all(word.isdigit() for word in words)
    text = f"{words[0]} to {words[-1]}" if digits else " or ".join(words)
    return text.replace("_", " "), "other" if part in entry.differences else "same"


def _lacking(entry: PropertyEntry) -> str:
    return "unverified" if entry.source == "unverified" else "not determined"


def fact_rows(audit: Audit) -> list[tuple[str, str, tuple[str, ...]]]:
    """Measured quantities with their unit, one column per recording."""
    rows = []
    for key, (name, unit) in _FACTS.items():
        values = [recording.facts.get(key) for recording in audit.recordings]
        if any(value is not None for value in values):
            cells = tuple("–" if value is None else f"{value:.2f}" for value in values)
            rows.append((name, unit, cells))
    return rows


def varying_rows(audit: Audit) -> list[tuple[str, tuple[str, ...]]]:
    """Topology that may vary (METHOD 4.2), one column per recording."""
    names = dict.fromkeys(name for r in audit.recordings for name in r.varying)
    return [
        (name, tuple(r.varying.get(name, ("–", "–"))[0] for r in audit.recordings))
        for name in names
    ]


def disclosure_rows(audit: Audit) -> list[tuple[str, tuple[str, ...]]]:
    """Allowed differences, one column per recording."""
    names = dict.fromkeys(name for r in audit.recordings for name in r.disclosures)
    return [(name, tuple(r.disclosures.get(name, "–") for r in audit.recordings)) for name in names]


def render(judged: Judged, on_picture: Callable[[int, int], None] = lambda done, of: None) -> str:
    """The page as HTML.

    Args:
        judged: the audit and what was examined.
        on_picture: told how many recordings have their pictures, and of how many.

    Raises:
        InputError: a frame in a bag is no picture.
    """
    audit = judged.audit
    strips: dict[str, Sequence[frames.Picture]] = {}
    for done, one in enumerate(judged.examined, start=1):
        strips[one.recording.provenance.domain] = frames.pictures(one)
        on_picture(done, len(judged.examined))
    environment = templates(_HERE)
    environment.filters["plain"] = _plain
    style = _REPORT_STYLE.read_text("utf-8") + (_HERE / "style.css").read_text("utf-8")
    return environment.get_template("page.html.j2").render(
        audit=audit,
        recordings=audit.recordings,
        columns=frames.COLUMNS,
        strips=strips,
        axis=Markup(phase_axis(audit.recordings)),
        fields=field_rows(audit),
        varying=varying_rows(audit),
        facts=fact_rows(audit),
        disclosures=disclosure_rows(audit),
        checks=TABLE,
        style=Markup(style),
        version=__version__,
    )


def _plain(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, sort_keys=True)
