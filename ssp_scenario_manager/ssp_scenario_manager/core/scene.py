"""What conditions are asked about: the states of one instant, and the phases that have begun."""

from __future__ import annotations

from collections.abc import Mapping

from ssp_core.geometry import Polyline
from ssp_core.motion.encounter import Encounter, encounter
from ssp_core.motion.state import ObjectState
from ssp_core.names import VUT_ID
from ssp_core.vocabulary import Phase


class Scene:
    """The states at the stamp of one VUT state. Whatever nobody asks about isn't computed.

    An object's state is extrapolated to the VUT's stamp, with speed and yaw rate held. It is
    unknown (None) where the object was never heard, a number of it isn't finite, or its stamp is
    further from the VUT's than ``state_age_ns``, before or after.

    Args:
        vut: state of the VUT; its stamp is the scene's.
        targets: newest states by id.
        path: the VUT's planned path, frame map.
        state_age_ns: how far a state may be extrapolated (``limits.state_age_s``).
        phases: session times at which phases of the event began, as far as that is known.
    """

    __slots__ = ("_age_ns", "_front_m", "_known", "_meetings", "_targets", "path", "phases", "vut")

    def __init__(
        self,
        vut: ObjectState,
        targets: Mapping[str, ObjectState],
        path: Polyline,
        state_age_ns: int,
        phases: Mapping[Phase, int],
    ) -> None:
        self.vut = vut
        self.path = path
        self.phases = phases
        self._targets = targets
        self._age_ns = state_age_ns
        self._known: dict[str, ObjectState | None] = {}
        self._meetings: dict[str, Encounter | None] = {}
        self._front_m: float | None = None

    @property
    def stamp_ns(self) -> int:
        return self.vut.stamp_ns

    def state(self, object_id: str) -> ObjectState | None:
        """State of the VUT or an object at the scene's stamp; None: unknown."""
        if object_id not in self._known:
            self._known[object_id] = self._extrapolated(object_id)
        return self._known[object_id]

    def _extrapolated(self, object_id: str) -> ObjectState | None:
        heard = self.vut if object_id == VUT_ID else self._targets.get(object_id)
        if heard is None or not heard.is_finite:
            return None
        if heard.stamp_ns == self.stamp_ns:
            return heard
        if abs(self.stamp_ns - heard.stamp_ns) > self._age_ns:
            return None
        return heard.extrapolated(self.stamp_ns)

    def meeting(self, object_id: str) -> Encounter | None:
        """How an object stands to the VUT (METHOD 1); None: unknown."""
        if object_id not in self._meetings:
            vut, other = self.state(VUT_ID), self.state(object_id)
            if vut is None or other is None:
                self._meetings[object_id] = None
            else:
                self._meetings[object_id] = encounter(vut, other, self.path)
        return self._meetings[object_id]

    def vut_front_m(self) -> float | None:
        """Arc length of the VUT's foremost point along its path; None: unknown."""
        if self._front_m is None:
            vut = self.state(VUT_ID)
            if vut is None:
                return None
            station, _ = self.path.project_beyond(vut.x_m, vut.y_m)
            self._front_m = station + vut.size.front_m
        return self._front_m
