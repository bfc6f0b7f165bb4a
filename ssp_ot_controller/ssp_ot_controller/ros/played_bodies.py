"""The node ``played_bodies``: declares that the objects of a rehearsal are simulated.

The bodies themselves are heard over UDP or ISO 22133, at whose other end a commander can't know
what is; the program that plays them knows it.
"""

from __future__ import annotations

import sys

from rclpy.node import Node

from ssp_core import names, ros
from ssp_core.run_file.model import load_run
from ssp_core.run_file.participation import ParticipantKind, body_of
from ssp_ot_controller.ros.parameters import PLAYED_BODIES


class PlayedBodies(Node):
    """Declares the kind of all objects of a run and of their bodies, latched, while they play."""

    def __init__(self, _stop: ros.StopRequest) -> None:
        super().__init__("played_bodies", namespace=names.NAMESPACE)
        run = load_run(ros.declare(self, PLAYED_BODIES)["run_file"])
        for target in run.targets:
            ros.declare_kind(self, ParticipantKind.SIMULATED, target.id, body_of(target.id))


def main() -> None:
    """Run the node."""
    sys.exit(ros.run_node(PlayedBodies, lambda _node: None))


if __name__ == "__main__":
    main()
