"""The plant of the simulated world: what moves the bodies of VUT and object targets in a step.

The world asks a plant and nothing else; watchdogs, faults, the fence and the limits stand around
it, whichever it is. Ours (``OwnBodies``) is the default; CARLA's is in ``carla_bodies``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from ssp_core.run_file.model import RunSpec
from ssp_ot_controller.bodies.dynamics import BodyState, Command, step_body


class BodyPlant(Protocol):
    """The bodies of a run's VUT and object targets."""

    def start(self) -> dict[str, BodyState]:
        """Give the bodies at rest, before the first step."""
        ...

    def step(
        self, bodies: Mapping[str, BodyState], commands: Mapping[str, Command]
    ) -> dict[str, BodyState]:
        """Give the bodies one step later.

        Args:
            bodies: as ``start`` or the step before gave them.
            commands: what each actuator does in this step, by object.

        Raises:
            PeerError: what moves them failed.
        """
        ...

    def close(self) -> list[str]:
        """Give everything back; what couldn't be, in words."""
        ...


def lag_scale(run: RunSpec, object_id: str) -> float:
    """Return the factor on an actuator's lags.

    The run's general disturbance is of the objects' actuators; the VUT's has to be named.
    """
    if object_id == run.vut.id and object_id not in run.disturbances:
        return 1.0
    return run.disturbance_of(object_id).actuator_lag_scale


class OwnBodies:
    """Our own bodies (``dynamics``): the same commands, the same motion to the last bit."""

    def __init__(self, run: RunSpec) -> None:
        specs = (run.vut, *run.targets)
        self._starts = {spec.id: spec.start.pose for spec in specs}
        self._kinds = {spec.id: (spec.cls, lag_scale(run, spec.id)) for spec in specs}
        self._step_s = run.step_s

    def start(self) -> dict[str, BodyState]:
        return {object_id: BodyState.at_rest(pose) for object_id, pose in self._starts.items()}

    def step(
        self, bodies: Mapping[str, BodyState], commands: Mapping[str, Command]
    ) -> dict[str, BodyState]:
        kinds, dt_s = self._kinds, self._step_s
        return {
            name: step_body(kinds[name][0], body, commands[name], dt_s, lag_scale=kinds[name][1])
            for name, body in bodies.items()
        }

    def close(self) -> list[str]:
        return []
