"""``ssp.faults/1``: faults and disturbances that are added to a run, and what they may strike."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pydantic import Field

from ssp_core.errors import InputError
from ssp_core.files.reading import load_model
from ssp_core.run_file.model import Fault, FaultKind, LinkDisturbance, RunSpec
from ssp_core.run_file.values import ObjectId, Strict

FAULTS_SCHEMA: Literal["ssp.faults/1"] = "ssp.faults/1"


class FaultFile(Strict):
    """The faults that are to strike in a run, in a file of its own."""

    schema_: Literal["ssp.faults/1"] = Field(FAULTS_SCHEMA, alias="schema")
    faults: list[Fault] = Field([], description="added to those of the run")
    disturbance: LinkDisturbance | None = Field(None, description="instead of the run's")
    disturbances: dict[ObjectId, LinkDisturbance] = Field(
        {}, description="of single objects, instead of what the run has for them"
    )


@dataclass(frozen=True, slots=True)
class _Rule:
    """The parameters of a kind of fault.

    Args:
        objects: what it strikes: the VUT, or any object.
        value: whether it has one: never, maybe or always.
        low: the value is above this, where it has a bound.
        high: and at most this.
    """

    objects: Literal["vut", "any"]
    value: Literal["never", "maybe", "always"] = "never"
    low: float | None = None
    high: float | None = None
    unit: str = ""


# The faults of objects; those of nodes, operator and references are the runner's.
_RULES: dict[FaultKind, _Rule] = {
    "link_cut": _Rule("any"),
    "link_delay": _Rule("any", "always", low=0.0, unit="s, one way"),
    "link_loss": _Rule("any", "always", low=0.0, high=1.0, unit="share"),
    "link_reorder": _Rule("any", "always", low=0.0, high=1.0, unit="share"),
    "clock_step": _Rule("any", "always", unit="s"),
    "position_jump": _Rule("any", "always", unit="m to the left"),
    "state_nan": _Rule("any"),
    "state_frozen": _Rule("any"),
    "actuator_stuck": _Rule("any", "maybe", unit="m/s^2"),
    "vut_stop": _Rule("vut", "maybe", low=0.0, unit="m/s^2"),
}


def load_faults(path: str | Path) -> FaultFile:
    """Read a fault file.

    Raises:
        InputError: it can't be read or is not valid.
    """
    return load_model(FaultFile, path)


def with_faults(run: RunSpec, extra: FaultFile, file: str | Path) -> RunSpec:
    """Return the run with the faults and disturbances of a file.

    Raises:
        InputError: a fault or a disturbance is of something that the run doesn't have, its value
            makes no sense, or its time comes when the run is over.
    """
    object_ids = run.object_ids
    for object_id in extra.disturbances:
        if object_id not in object_ids:
            raise InputError(
                "is no object of this run",
                file=file,
                field=f"disturbances.{object_id}",
                remedy=f"choose {', '.join(object_ids)}",
            )
    check_object_faults(run, extra.faults, file)
    _check_times(run, extra.faults, file)
    return run.model_copy(
        update={
            "faults": [*run.faults, *extra.faults],
            "disturbance": extra.disturbance or run.disturbance,
            "disturbances": {**run.disturbances, **extra.disturbances},
        }
    )


def check_object_faults(run: RunSpec, faults: list[Fault], file: str | Path | None = None) -> None:
    """Refuse faults of objects that strike nothing in this run, or with a value of no use.

    Raises:
        InputError: naming the fault's field.
    """
    for index, fault in enumerate(faults):
        rule = _RULES.get(fault.kind)
        if rule is None:
            continue
        object_ids = run.object_ids if rule.objects == "any" else [run.vut.id]
        if fault.target not in object_ids:
            raise InputError(
                f"is no object that {fault.kind} can strike in this run",
                file=file,
                field=f"faults[{index}].target",
                value=fault.target,
                remedy=f"choose {', '.join(object_ids)}",
            )
        if wrong := _wrong_value(rule, fault):
            problem, remedy = wrong
            field = f"faults[{index}].value"
            raise InputError(problem, file=file, field=field, value=fault.value, remedy=remedy)


def _check_times(run: RunSpec, faults: list[Fault], file: str | Path) -> None:
    over_s = min(run.end.at_latest_s, run.limits.duration_s)
    for index, fault in enumerate(faults):
        if fault.at_s is not None and fault.at_s >= over_s:
            raise InputError(
                "comes when the run is over",
                file=file,
                field=f"faults[{index}].at_s",
                value=fault.at_s,
                remedy=f"give a time before {over_s:g} s",
            )


def _wrong_value(rule: _Rule, fault: Fault) -> tuple[str, str] | None:
    """Say what is wrong with a fault's value, and the remedy."""
    value, low, high = fault.value, rule.low, rule.high
    if value is None:
        needed = rule.value == "always"
        return (
            (f"is missing: {fault.kind} has a size", f"give it ({rule.unit})") if needed else None
        )
    if rule.value == "never":
        return f"means nothing for {fault.kind}", "leave it out"
    if (low is not None and value <= low) or (high is not None and value > high):
        top = f" and at most {high:g}" if high is not None else ""
        return f"is no size of {fault.kind}", f"give a number above {low:g}{top} ({rule.unit})"
    return None
