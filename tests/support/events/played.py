"""An OpenSCENARIO export as a player shows it, beside the session that it was made from."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ssp_core.clock import ns_to_seconds
from ssp_core.geometry import FloatArray, wrap_angle
from ssp_core.motion.corridor import Corridor
from ssp_core.motion.passing import passing_since
from ssp_core.motion.state import ObjectState
from ssp_scenario_manager.compile.targets.openscenario import export_openscenario
from ssp_scenario_manager.compile.targets.player import play
from ssp_scenario_manager.compile.task import Task
from ssp_scenario_manager.maps.block import Block
from ssp_scenario_manager.run.feasibility import driven
from ssp_scenario_manager.run.result import instants


@dataclass(frozen=True)
class Shown:
    """VUT and initiator in a session and as a player has them, up to the end of what it plays."""

    session: list[list[ObjectState]]
    player: list[list[ObjectState]]
    fired_s: float

    def apart_m(self) -> float:
        """The largest distance of one of them from where the session has it."""
        return max(
            math.dist((a.x_m, a.y_m), (b.x_m, b.y_m))
            for states, shown in zip(self.session, self.player, strict=True)
            for a, b in zip(states, shown, strict=True)
        )

    def gap_differs_s(self, corridor_of: Callable[[Sequence[ObjectState]], Corridor]) -> float:
        """Return how much longer the player's time gap (METHOD 1) is, in corridors of the VUT."""
        gaps_s = []
        for vut, other in (self.player, self.session):
            corridor = corridor_of(vut)
            gaps_s.append(passing_since(instants(vut, other), corridor, self.fired_s).time_gap_s)
        longer, shorter = gaps_s
        assert longer is not None
        assert shorter is not None
        return longer - shorter


def shown(task: Task, block: Block, folder: Path) -> Shown:
    """Export a task into a folder, play it, and drive its session.

    Raises:
        InputError: the export is refused.
    """
    files = export_openscenario(task, block, None, folder)
    played = play(files[0].read_bytes(), files[2].read_bytes(), block.line)
    result, record = driven(task.run)
    sessions, players = [], []
    for who in ("vut", task.run.initiator_id):
        last_s = played[who][-1, 0]
        states = [one for one in record.truths(who) if ns_to_seconds(one.stamp_ns) <= last_s]
        sessions.append(states)
        players.append(_as_played(states, played[who]))
    return Shown(sessions, players, ns_to_seconds(result.triggers[0].crossing_ns))


def _as_played(states: Sequence[ObjectState], track: FloatArray) -> list[ObjectState]:
    """A session's states, at the places at which a player has the object."""
    times = [ns_to_seconds(state.stamp_ns) for state in states]
    yaws = np.unwrap(track[:, 3])
    columns = (np.interp(times, track[:, 0], c).tolist() for c in (track[:, 1], track[:, 2], yaws))
    return [
        replace(state, x_m=x, y_m=y, yaw_rad=wrap_angle(yaw))
        for state, x, y, yaw in zip(states, *columns, strict=True)
    ]
