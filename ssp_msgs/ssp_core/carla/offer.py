"""The bodies that a server offers: measured when first asked for, and chosen by class and size."""

from __future__ import annotations

from ssp_core.carla.blueprints import ChosenBody, choose_body, is_candidate
from ssp_core.carla.client import CarlaServer
from ssp_core.carla.frame import BodyBox
from ssp_core.errors import PeerError
from ssp_core.motion.state import Size
from ssp_core.vocabulary import ObjectClass


class Offer:
    """The blueprints of a server, and the boxes of those that were measured.

    Args:
        server: that this client ticks.
    """

    def __init__(self, server: CarlaServer) -> None:
        self._server = server
        self._blueprints = server.blueprints()
        self._boxes: dict[str, BodyBox] = {}

    def spawn(
        self, object_id: str, object_class: ObjectClass, size: Size
    ) -> tuple[int, ChosenBody]:
        """Spawn the body of the class that is nearest in size, high above the ground.

        Raises:
            PeerError: there is none, or it isn't spawned.
        """
        candidates = [one.id for one in self._blueprints if is_candidate(one, object_class)]
        self._boxes |= self._server.measure([n for n in candidates if n not in self._boxes])
        body = choose_body(object_class, size, self._blueprints, self._boxes)
        (actor,) = self._server.spawn([(object_id, body.blueprint)])
        if isinstance(actor, str):
            raise PeerError(f"CARLA doesn't spawn {body.blueprint} for {object_id}: {actor}")
        return actor, body
