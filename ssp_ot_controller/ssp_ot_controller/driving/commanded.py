"""The VUT in the world's own process: its reports, and its driver if it gets no plans."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ssp_core import names
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_ot_controller.bodies.dynamics import Command
from ssp_ot_controller.sil.disturbance import Channel
from ssp_ot_controller.sil.world import World

if TYPE_CHECKING:
    from ssp_ot_controller.driving.pilot import Pilot


class WorldsVut:
    """The VUT as the world's process has it. Reads no clock.

    A driver that commands without plans has no node (METHOD 8.1): the world has it lead the VUT.
    """

    def __init__(self, run: RunSpec) -> None:
        self.channel = Channel(run, names.VUT_ID)
        driven = None if run.has_driver_node else run.driven
        self._newest: ObjectState | None = None
        self._pilot: Pilot | None = None
        if driven is not None:
            # Its SciPy takes a quarter of a second to load, which other sessions don't need.
            from ssp_ot_controller.driving.pilot import pilot_of

            self._pilot = pilot_of(run, driven, None)

    def report(self, world: World) -> list[ObjectState]:
        """Return the states that arrive now, of those that the VUT has reported."""
        now_ns = world.now_ns
        arrived = self.channel.up(self.channel.measure(world.vut(), now_ns), now_ns)
        self._newest = arrived[-1] if arrived else self._newest
        return arrived

    def lead(self, world: World, commands: dict[str, tuple[int, Command]]) -> None:
        """Command the VUT until the next step, unless somebody else does."""
        if self._pilot is not None and self._newest is not None:
            self._pilot.lead(world, self._newest, world.objects(), commands)
