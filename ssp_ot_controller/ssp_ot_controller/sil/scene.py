"""The surroundings of a simulated run: SUMO's traffic, or no one where the run has none."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_ot_controller.sil.world import TrafficSimulation


class NoTraffic:
    """A scene without anybody but the VUT and the targets: SUMO has nothing to say in it."""

    def step(self, _poses: list[ObjectState]) -> list[ObjectState]:
        return []

    def traffic(self) -> list[ObjectState]:
        return []


@contextmanager
def scene_of(run: RunSpec, work_dir: Path | None = None) -> Iterator[TrafficSimulation]:
    """Give a run's surroundings; SUMO is loaded and started only where the run has traffic.

    Args:
        run: to be simulated.
        work_dir: for SUMO's files; None: a folder that goes with the scene.

    Raises:
        HostError: SUMO doesn't start.
        InputError: there is no room for the traffic at its start.
    """
    if not run.traffic:
        yield NoTraffic()
        return
    from ssp_ot_controller.sil.sumo_world import SumoWorld

    with (
        tempfile.TemporaryDirectory(prefix="ssp-sumo-") as folder,
        SumoWorld(run, work_dir or Path(folder)) as world,
    ):
        yield world
