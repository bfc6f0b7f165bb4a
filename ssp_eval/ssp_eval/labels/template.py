"""A labels file to be filled in by hand: nine times, and nothing said about any of them.

A template has the form of a labels file with ``phase: null`` in every label that nobody has filled
in, which no labels file has (METHOD 5.2); so it can't be taken for an answer, whatever reads it.
``objects``, ``position``, ``motion`` and ``conflict`` may stay null: not evaluable at that time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

SCHEMA = "ssp.labels/1"
FILL_IN = "template: fill in"
# What a label can't be without.
_NEEDED = ("phase", "risk_visible", "lon_actions", "lat_actions")


def template_json(
    scenario: str, domain: str, event_version: str, times_s: Sequence[float]
) -> dict[str, Any]:
    """The content of a template.

    Args:
        scenario: name.
        domain: of METHOD 5.2.
        event_version: K* version, or a word that says that nobody knows it.
        times_s: clip times, rising.
    """
    return {
        "schema": SCHEMA,
        "scenario": scenario,
        "domain": domain,
        "event_version": event_version,
        "risk_time_s": None,
        "first_frame_dynamics": False,
        "labels": [
            {
                "t_s": t_s,
                "phase": None,
                "risk_visible": None,
                "objects": None,
                "position": None,
                "motion": None,
                "conflict": None,
                "lon_actions": [],
                "lat_actions": [],
            }
            for t_s in times_s
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
    return "phase" in label and label["phase"] is None
