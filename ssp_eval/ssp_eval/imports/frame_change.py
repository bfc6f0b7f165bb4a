"""Do a video's frames stand when its VUT stands? A table of another run shows itself so."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from ssp_core.bag.still_images import Bgr
from ssp_core.geometry import FloatArray

STANDING_MPS = 0.1
DRIVING_MPS = 2.0
# So many pairs of frames of either kind are needed to say anything.
_LEAST_PAIRS = 5
# Frames that change so many times as much while the VUT stands are another run's.
CONTRARY = 2.0
_SIZE_PX = (64, 36)


@dataclass
class FrameChange:
    """How much each frame of a clip differs from the one before, in grey levels."""

    _last: FloatArray | None = None
    _found: list[float] = field(default_factory=list)

    def take(self, image: Bgr) -> None:
        """The next frame."""
        small = cv2.resize(image, _SIZE_PX, interpolation=cv2.INTER_AREA)
        grey = np.asarray(small, dtype=np.float64).mean(axis=2)
        if self._last is not None:
            self._found.append(float(np.abs(grey - self._last).mean()))
        self._last = grey

    def contrast(self, speed_mps: FloatArray) -> float | None:
        """Change while the VUT stands over change while it drives, medians.

        Args:
            speed_mps: of the VUT at each frame.

        Returns:
            None where the clip doesn't show enough of both; otherwise well under 1 where the
            speeds are those of the camera.
        """
        speed = np.abs(speed_mps)
        changes = np.array(self._found)
        standing = changes[np.maximum(speed[1:], speed[:-1]) < STANDING_MPS]
        driving = changes[np.minimum(speed[1:], speed[:-1]) > DRIVING_MPS]
        if min(len(standing), len(driving)) < _LEAST_PAIRS:
            return None
        # A still picture changes by less than a hundredth of a grey level.
        return float(np.median(standing) / max(float(np.median(driving)), 0.01))
