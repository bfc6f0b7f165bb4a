"""Draws of a run's values from K*'s box, by seed (METHOD 8.1)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ssp_core.files.reading import parse_model
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import Hold
from ssp_scenario_manager.closed_loop.starts.places import GapDraw, placed_run, span_of
from ssp_scenario_manager.closed_loop.starts.ways import drawn_kerb, drawn_line
from ssp_scenario_manager.compile.task import NO_TUNINGS, Tuning
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.scenarios.planning import BODY_MPS2
from ssp_scenario_manager.scenarios.values import quantity_at

# Fields of a manoeuvre by K*'s names of its quantities.
_OF_MANOEUVRE = {
    "duration": "duration_s",
    "end_speed": "cruise_mps",
    "deceleration": "deceleration_mps2",
}
_OF_BRAKING = {"end_speed": "to_mps", "deceleration": "deceleration_mps2"}
_OF_PATH = {
    "walking_speed": "cruise_mps",
    "merging_speed": "cruise_mps",
    "circulating_speed": "cruise_mps",
    "crossing_speed": "cruise_mps",
    "acceleration": "acceleration_mps2",
}
_OF_KIND = {
    "lane_change": _OF_MANOEUVRE,
    "brake": _OF_BRAKING,
    "follow_path": _OF_PATH,
    "hold": dict[str, str](),
}
# Generators of a seed, by number. What came later has one of its own: the other values stay.
_COMMON, _LENGTHS, _GAPS, _KERB, _LINE = 8, 9, 10, 12, 13
_OWN = {"crossing_speed": 11}


def draw_run_values(
    run: RunSpec, event: Event, seed: int, tunings: Mapping[str, Tuning] = NO_TUNINGS
) -> tuple[RunSpec, dict[str, float]]:
    """Return the run with values drawn from K*'s box, and these by field of run file or K*.

    Each quantity that K* gives an interval is drawn uniformly from it, in an order of its own, so
    that a seed gives the same values everywhere; a speed from the part of it that place and bend
    allow, an acceleration from what the object's class and the place's limits allow. Other values
    stay as they were compiled. Gaps at the start are drawn by ``gap_draw``: how small they may be
    depends on all else.

    Args:
        run: as it was compiled.
        event: K*, that it was compiled from.
        seed: of the start.
        tunings: of the task that the run is of, by field of K*. Without them the place's limits are
            unknown; ``crossing_speed`` and the distance to the kerb stay as compiled.

    Raises:
        InputError: the values make no run.
    """
    data: dict[str, Any] = run.model_dump(mode="json", by_alias=True)
    random = _generator(seed, _COMMON)
    values: dict[str, float] = {}

    def draw(
        quantity: str,
        *fields: str,
        most: float = math.inf,
        generator: np.random.Generator = random,
    ) -> None:
        span = span_of(quantity_at(event, quantity))
        if span is None or not all(_holds(data, field) for field in fields):
            return
        tuning = tunings.get(quantity)
        if tuning is not None and tuning.at_most is not None:
            most = min(most, tuning.at_most)
        high = max(span.low, min(span.high, most))
        value = round(float(generator.uniform(span.low, high)), 3)
        for field in fields:
            _put(data, field, value)
            values[field] = value

    draw(_approach(event.vut_id), "driver.cruise_mps", "vut.approach.cruise_mps")
    acting = next((i for i, t in enumerate(run.triggers) if not isinstance(t.manoeuvre, Hold)), 0)
    manoeuvre = run.triggers[acting].manoeuvre
    for i, target in enumerate(run.targets):
        fields = [f"targets.{i}.approach.cruise_mps"]
        if acting and target.id == run.triggers[acting].object_id:
            # What leaves the lane keeps its speed.
            fields.append(f"triggers.{acting}.manoeuvre.cruise_mps")
        draw(_approach(target.id), *fields)
    # Where another object than the initiator acts, both triggers have one condition.
    conditions = [f"triggers.{i}.condition" for i, _ in enumerate(run.triggers)]
    for field in ("below_m", "below_s"):
        draw("constraints.trigger.below", *(f"{at}.{field}" for at in conditions))
    within = "manoeuvre.motion" if manoeuvre.kind == "follow_path" else "manoeuvre"
    names = _OF_KIND[manoeuvre.kind]
    body = event.participants[run.triggers[acting].object_id].class_
    hardest = min(BODY_MPS2[body][0], run.limits.acceleration_mps2)
    for name in sorted(event.constraints.manoeuvre.keys() & names.keys()):
        quantity, field = (
            f"constraints.manoeuvre.{name}",
            f"triggers.{acting}.{within}.{names[name]}",
        )
        most = hardest if name == "acceleration" else math.inf
        if name not in _OWN:
            draw(quantity, field, most=most)
        elif quantity in tunings:
            draw(quantity, field, most=most, generator=_generator(seed, _OWN[name]))
    data["seed"] = seed
    parsed = parse_model(RunSpec, data, f"the start of seed {seed}")
    placed, lengths = placed_run(parsed, event, _generator(seed, _LENGTHS).uniform)
    placed, to_kerb = drawn_kerb(placed, event, tunings, _generator(seed, _KERB).uniform)
    placed, to_line = drawn_line(placed, event, _generator(seed, _LINE).uniform)
    return placed, values | lengths | to_kerb | to_line


def gap_draw(run: RunSpec, event: Event, seed: int) -> GapDraw:
    """Return the draw of the gaps at the start of a run that ``draw_run_values`` gave.

    Args:
        run: with all else drawn.
        event: K*.
        seed: of the start.
    """
    random = _generator(seed, _GAPS)
    shares = {target.id: float(random.uniform()) for target in run.targets}
    return GapDraw(run, event, shares)


def _generator(seed: int, number: int) -> np.random.Generator:
    return np.random.default_rng([seed, number])


def _approach(object_id: str) -> str:
    return f"constraints.speeds.{object_id}.approach"


def _holds(data: dict[str, Any], field: str) -> bool:
    holder: Any = data
    for key in field.split("."):
        if isinstance(holder, list):
            holder = holder[int(key)]
        elif isinstance(holder, dict) and key in holder:
            holder = holder[key]
        else:
            return False
    return isinstance(holder, int | float) and not isinstance(holder, bool)


def _put(data: dict[str, Any], field: str, value: float) -> None:
    holder: Any = data
    *way, last = field.split(".")
    for key in way:
        holder = holder[int(key)] if isinstance(holder, list) else holder[key]
    holder[last] = value
