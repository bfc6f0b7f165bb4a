"""Fixtures of the bridge's tests: requests, responses, and scenes drawn for them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np
import pytest
from ssp_vla_bridge.core.request import CameraGeometry, EgoSample, Frame, Request
from ssp_vla_bridge.core.response import NativeArray, Response

NS = 1_000_000_000


def encode(image: np.ndarray) -> bytes:
    ok, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 90])
    if not ok:
        raise ValueError("OpenCV can't encode this image")
    return data.tobytes()


@pytest.fixture(scope="session")
def grey_jpeg() -> bytes:
    """A small grey picture."""
    return encode(np.full((72, 128, 3), 128, np.uint8))


@pytest.fixture
def straight_history() -> Callable[..., tuple[EgoSample, ...]]:
    """Two seconds of straight driving at 10 Hz that end at ``speed_mps``."""

    def make(speed_mps: float, acceleration_mps2: float = 0.0, yaw_rate_radps: float = 0.0):
        samples = []
        for step in range(-20, 1):
            t_s = step * 0.1
            x_m = speed_mps * t_s + acceleration_mps2 * t_s**2 / 2
            speed = speed_mps + acceleration_mps2 * t_s
            samples.append(EgoSample(t_s, x_m, 0.0, 0.0, speed, yaw_rate_radps))
        return tuple(samples)

    return make


@pytest.fixture
def make_request(grey_jpeg: bytes) -> Callable[..., Request]:
    """A good request; ``jpegs`` become frames at 10 Hz, the last one at ``stamp_ns``."""

    def make(
        request_id: str = "r1",
        stamp_ns: int = 10 * NS,
        jpegs: Sequence[bytes] | None = None,
        history: tuple[EgoSample, ...] = (),
        camera: CameraGeometry | None = None,
    ) -> Request:
        pictures = [grey_jpeg] if jpegs is None else list(jpegs)
        first_ns = stamp_ns - (len(pictures) - 1) * NS // 10
        frames = tuple(Frame(first_ns + i * NS // 10, jpeg) for i, jpeg in enumerate(pictures))
        provenance = "measured" if history else "unknown"
        return Request(request_id, stamp_ns, frames, camera, history, provenance)

    return make


@pytest.fixture
def make_response() -> Callable[..., Response]:
    """A response with one array ``trajectory`` of the given rows."""

    def make(
        rows: Sequence[Sequence[float]] = (),
        step_s: float = 0.5,
        first_time_s: float = 0.0,
        frame: str = "ego_xy",
        unit: str = "m",
        text: str = "I keep my speed.",
    ) -> Response:
        data = tuple(float(value) for row in rows for value in row)
        array = NativeArray("trajectory", (len(rows), 2), data, frame, unit, step_s, first_time_s)
        return Response("r1", 10 * NS, "model", "model/1", text, (array,))

    return make
