"""What there is to draw at one instant."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from ssp_core.motion.state import ObjectState
from ssp_core.run_file.road import Road
from ssp_ot_controller.camera.indicators import Indicator


@dataclass(frozen=True)
class Scene:
    """What is there at one instant.

    Args:
        road: the block.
        vut: state of the vehicle that carries the camera; it isn't drawn, but casts a shadow.
        objects: ground truth of all others, frame map; the VUT may be among them.
        travelled_m: distance travelled so far by object id, which moves legs, pedals and wheels.
        indicators: those that blink, by object id.
    """

    road: Road
    vut: ObjectState
    objects: tuple[ObjectState, ...]
    travelled_m: Mapping[str, float] = field(default_factory=dict)
    indicators: Mapping[str, Indicator] = field(default_factory=dict)

    @property
    def others(self) -> list[ObjectState]:
        """All but the VUT."""
        return [o for o in self.objects if o.object_id != self.vut.object_id]

    def before(self, by_s: float) -> Scene:
        """The same a moment earlier, with speeds and yaw rates held: for one exposure's length."""
        shift_ns = round(by_s * 1e9)
        # Lamps don't change within an exposure: states keep their stamps.
        earlier = {
            o.object_id: replace(o.extrapolated(o.stamp_ns - shift_ns), stamp_ns=o.stamp_ns)
            for o in (*self.objects, self.vut)
        }
        return Scene(
            self.road,
            earlier[self.vut.object_id],
            tuple(earlier[o.object_id] for o in self.objects),
            {
                key: way - by_s * (earlier[key].speed_mps if key in earlier else 0.0)
                for key, way in self.travelled_m.items()
            },
            self.indicators,
        )
