"""What disturbs a run: seeded disturbances, and faults that are injected on purpose."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import (
    Field,
)

from ssp_core.run_spec.values import Finite, NonNegative, Positive, Strict


class LinkDisturbance(Strict):
    """Seeded disturbance of one object's links, sensors and actuators; zero is off.

    Up is from the object to the manager, down from the manager to the object; one way each.
    """

    state_delay_s: NonNegative = Field(0.0, description="up")
    state_jitter_s: NonNegative = Field(0.0, description="up, one sigma added to the delay")
    state_loss: Annotated[float, Field(ge=0, lt=1)] = Field(0.0, description="up")
    reorder: Annotated[float, Field(ge=0, lt=1)] = Field(
        0.0, description="up: share of states that are overtaken by the next one"
    )
    command_delay_s: NonNegative = Field(0.0, description="down")
    command_loss: Annotated[float, Field(ge=0, lt=1)] = Field(0.0, description="down")
    clock_offset_s: Finite = Field(0.0, description="the object's clock minus the manager's")
    position_noise_m: NonNegative = 0.0
    speed_noise_mps: NonNegative = 0.0
    dropout_per_s: NonNegative = Field(0.0, description="how often localisation fails")
    dropout_s: NonNegative = Field(0.2, description="for how long")
    actuator_lag_scale: Positive = 1.0


FaultKind = Literal[
    "kill",
    "pause",
    "disk_full",
    "operator_abort",
    "link_cut",
    "link_delay",
    "link_loss",
    "link_reorder",
    "clock_step",
    "position_jump",
    "state_nan",
    "state_frozen",
    "actuator_stuck",
    "vut_stop",
    "reference_stale",
    "reference_out_of_fence",
    "trigger_never",
]


class Fault(Strict):
    """A fault that is injected on purpose.

    ``kill``, ``pause`` and ``disk_full`` strike a node, by its name; the others an object by its
    id, the VUT included; ``operator_abort`` and ``trigger_never`` strike the session.
    """

    kind: FaultKind
    target: str = Field("", description="node or object; empty for the session")
    at_s: NonNegative | None = Field(None, description="session time; null: armed, before start")
    duration_s: Positive | None = Field(None, description="null: for good")
    value: Finite | None = Field(None, description="s, share, m or m/s^2, by kind")


# Faults of processes and of the operator: they touch no object's sensors, links or actuators.
LIVE_FAULTS: frozenset[FaultKind] = frozenset(
    {"kill", "pause", "disk_full", "operator_abort", "trigger_never"}
)
