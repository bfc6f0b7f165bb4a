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


def groups_of(cards: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """Return the drivers of cards in groups with like conditions.

    Those with drivers of the plan come first.
    """
    found: dict[str, list[str]] = {}
    for card in cards:
        contains = [one["contains"] for one in card["latencies"]]
        key = repr([*(card[name] for name in CONDITIONS), card["limits"], contains])
        found.setdefault(key, []).append(card["driver"])
    return sorted(found.values(), key=lambda group: all(one in BASELINES for one in group))


def group_numbers(cards: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """Return the number of each driver's group, from 1."""
    return {name: k for k, group in enumerate(groups_of(cards), 1) for name in group}


def conditions_of(card: Mapping[str, Any]) -> str:
    """Return what a driver has in common with those of its group, in words."""
    if card["tracker"] is None:
        return "prescribed motion, outside the plant: no plans, no latency"
    route = "no route" if card["route_m"] is None else f"route {card['route_m']:g} m ahead"
    seen = "by camera" if card["cameras"] else "no frames"
    return f"plans tracked, {route}, {seen}, a question each {card['frame_period_s']:g} s at most"
