"""The pictures that a camera of CARLA sends, each found by the number of its frame."""

from __future__ import annotations

import queue
import time
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ssp_core.carla.frame import CarlaPose


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture of one frame.

    Args:
        pose: of the camera when it was taken.
        pixels: shape (height, width, 3), uint8, blue, green, red.
    """

    frame: int
    pose: CarlaPose
    pixels: NDArray[np.uint8]


class CarlaCamera:
    """The pictures of a camera, by the number of their frame.

    Args:
        sensor: carla.Sensor.

    Attributes:
        attributes: all of its attributes, as it was spawned with.
    """

    def __init__(self, sensor: Any) -> None:
        self.actor = int(sensor.id)
        self.attributes = {str(name): str(value) for name, value in sensor.attributes.items()}
        self.newest = 0
        self._pictures: queue.Queue[Picture] = queue.Queue()
        sensor.listen(self._on_image)

    def _on_image(self, image: Any) -> None:
        """Run in a thread of CARLA's client."""
        shape = (image.height, image.width, 4)
        pixels = np.frombuffer(image.raw_data, np.uint8).reshape(shape)
        bgr = np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGRA2BGR), np.uint8)
        self._pictures.put(Picture(int(image.frame), pose_of_transform(image.transform), bgr))

    def take(self, frame: int, wait_s: float) -> Picture | None:
        """Return the picture of a frame, None where it doesn't come; drop those of other frames."""
        until = time.monotonic() + wait_s
        while True:
            try:
                picture = self._pictures.get(timeout=max(0.0, until - time.monotonic()))
            except queue.Empty:
                return None
            self.newest = max(self.newest, picture.frame)
            if picture.frame == frame:
                return picture


def pose_of_transform(transform: Any) -> CarlaPose:
    """Return the location and rotation of a carla.Transform."""
    at, turn = transform.location, transform.rotation
    return CarlaPose(at.x, at.y, at.z, turn.pitch, turn.yaw, turn.roll)
