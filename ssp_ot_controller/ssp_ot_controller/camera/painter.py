"""The interface of a renderer of the front camera, and our own; CARLA's is in ``carla_painter``."""

from __future__ import annotations

from typing import Protocol

from ssp_core.run_file.model import Camera, RunSpec
from ssp_ot_controller.camera.kernels.jit import Array
from ssp_ot_controller.camera.renderer.render import render, warm_up
from ssp_ot_controller.camera.renderer.scene import Scene


class Painter(Protocol):
    """A renderer of the front camera."""

    def draw(self, scene: Scene, stamp_ns: int, index: int) -> Array:
        """Give the picture of a scene: shape (height, width, 3), uint8, blue, green, red.

        Args:
            scene: what the camera sees.
            stamp_ns: session time of the frame.
            index: number of the frame.

        Raises:
            PeerError: what draws it failed.
        """
        ...

    def close(self) -> list[str]:
        """Give everything back; what couldn't be, in words."""
        ...


class RasterPainter:
    """Our own renderer, warmed up.

    Args:
        run: with a camera.
    """

    def __init__(self, run: RunSpec, camera: Camera) -> None:
        self._run, self._camera = run, camera
        warm_up(run.road, run.look, camera, run.seed)

    def draw(self, scene: Scene, _stamp_ns: int, index: int) -> Array:
        return render(scene, self._run.look, self._camera, index, self._run.seed)

    def close(self) -> list[str]:
        return []
