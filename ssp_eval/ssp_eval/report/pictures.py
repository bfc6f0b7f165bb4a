"""Frames as they go into the page: small JPEG, once each, as data URIs."""

from __future__ import annotations

import base64
from pathlib import Path

import cv2
import numpy as np

from ssp_core.errors import InputError

MAX_WIDTH_PX = 640
_QUALITY = 72


def data_uri(path: Path) -> str:
    """A frame at most 640 px wide, as a data URI.

    Raises:
        InputError: it isn't there or is no picture.
    """
    try:
        data = np.frombuffer(path.read_bytes(), np.uint8)
    except OSError as error:
        raise InputError(f"can't be read: {error.strerror}", file=path) from error
    image = cv2.imdecode(data, cv2.IMREAD_COLOR) if data.size else None
    if image is None:
        raise InputError("is no picture", file=path)
    height, width = image.shape[:2]
    if width > MAX_WIDTH_PX:
        size = (MAX_WIDTH_PX, max(1, round(height * MAX_WIDTH_PX / width)))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
    return "data:image/jpeg;base64," + base64.b64encode(encoded.tobytes()).decode()
