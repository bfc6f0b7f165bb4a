"""Groups of drivers with like cards: results of others never share a column (METHOD 8.2, 8.7)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ssp_scenario_manager.closed_loop.campaigns.plan_file import BASELINES

# What must be like for two drivers' results to stand under one another.
CONDITIONS = (
    "cameras",
    "route_m",
    "step_s",
    "frame_period_s",
    "timeout_s",
    "tracker",
    "d_max_mps2",
)

# What is named of two groups whose usual words are alike.
_FURTHER = {
    "timeout_s": "timeout in s:",
    "step_s": "step in s:",
    "d_max_mps2": "D_max in m/s²:",
    "contains": "L:",
    "cameras": "camera:",
    "tracker": "tracker:",
    "limits": "limits:",
}


def groups_of(cards: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """Return the drivers of cards in groups with like conditions.

    Those with drivers of the plan come first.
    """
    groups: dict[str, list[str]] = {}
    for card in cards:
        contains = [one["contains"] for one in card["latencies"]]
        key = repr([*(card[name] for name in CONDITIONS), card["limits"], contains])
        groups.setdefault(key, []).append(card["driver"])
    return sorted(groups.values(), key=lambda group: all(one in BASELINES for one in group))


def group_numbers(cards: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """Return the number of each driver's group, from 1."""
    return {name: k for k, group in enumerate(groups_of(cards), 1) for name in group}


def headings_of(cards: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return what the drivers of each group have in common, in words, by groups_of.

    No two are alike: where the usual words are, the conditions that differ are named, too.
    """
    by_name = {card["driver"]: card for card in cards}
    first = [by_name[group[0]] for group in groups_of(cards)]
    words = [_conditions(card) for card in first]
    for name, label in _FURTHER.items():
        for same in dict.fromkeys(words):
            alike = [i for i, one in enumerate(words) if one == same]
            values = [_value(first[i], name) for i in alike]
            if len({repr(value) for value in values}) > 1:
                for i, value in zip(alike, values, strict=True):
                    words[i] += f", {label} {_value_text(value)}"
    return words


def _conditions(card: Mapping[str, Any]) -> str:
    if card["tracker"] is None:
        return "prescribed motion, outside the plant: no plans, no latency"
    route = "no route" if card["route_m"] is None else f"route {card['route_m']:g} m ahead"
    sight = "by camera" if card["cameras"] else "no frames"
    return f"plans tracked, {route}, {sight}, a question each {card['frame_period_s']:g} s at most"


def _value(card: Mapping[str, Any], name: str) -> Any:
    if name == "contains":
        return [one["contains"] for one in card["latencies"]]
    return card[name]


def _value_text(value: Any) -> str:
    """Return a condition's value in few words: those of objects one behind the other."""
    if isinstance(value, Mapping):
        return " ".join(f"{key} {_value_text(one)}" for key, one in value.items())
    if isinstance(value, list):
        return " and ".join(dict.fromkeys(map(_value_text, value))) or "none"
    return "none" if value is None else f"{value:g}" if isinstance(value, float) else str(value)
