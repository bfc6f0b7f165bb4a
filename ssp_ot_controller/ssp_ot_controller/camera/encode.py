"""JPEG encoding of frames."""

from __future__ import annotations

import cv2

from ssp_ot_controller.camera.jit import Array


def jpeg(image: Array, quality: int) -> bytes:
    """A picture (shape (height, width, 3), uint8, blue, green, red) as JPEG.

    Raises:
        ValueError: the encoder refused the picture.
    """
    done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise ValueError(f"a picture of shape {image.shape} can't be encoded as JPEG")
    return data.tobytes()
