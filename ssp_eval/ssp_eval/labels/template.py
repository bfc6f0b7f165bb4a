"""A labels file to be filled in by hand: its times, and nothing said about what is seen at them.

A template has the form of a labels file with ``risk_visible: null`` in every label that nobody has
filled in, which no labels file has (METHOD 5.2); so it can't be taken for an answer, whatever reads
it. On a clock grid ``phase`` is null too; in a plan (METHOD 5.2b) it is known.
``objects``, ``position``, ``motion`` and ``conflict`` may stay null: not evaluable at that time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ssp_eval.labels.place import BY_PHASE, At

SCHEMA = "ssp.labels/1"
FILL_IN = "template: fill in"
# What a label can't be without.
_NEEDED = ("phase", "risk_visible", "lon_actions", "lat_actions")


def template_json(
    scenario: str,
    domain: str,
    event_version: str,
    times_s: Sequence[float],
    places: Sequence[At] = (),
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
    everywhere: Sequence[At | None] = places or (None,) * len(times_s)
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
