"""Fixtures of the bridge's tests: requests, responses, and scenes drawn for them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import cv2
import numpy as np
import pytest

from ssp_vla_bridge.messages import CameraGeometry, EgoSample, Frame, NativeArray, Request, Response

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


WIDTH, HEIGHT, FOCAL = 720, 405, 470.0
CAMERA = CameraGeometry(FOCAL, FOCAL, (WIDTH - 1) / 2, (HEIGHT - 1) / 2, WIDTH, HEIGHT, 1.45, 0.03)


class Canvas:
    """A flat road under a pinhole camera, drawn polygon by polygon, farthest first."""

    def __init__(self, travelled_m: float, seed: int) -> None:
        self.image = np.full((HEIGHT, WIDTH, 3), (225, 190, 150), np.uint8)
        self._road(travelled_m)
        noise = np.random.default_rng(seed).normal(0, 1.5, self.image.shape)
        self.image = np.clip(self.image + noise, 0, 255).astype(np.uint8)

    def point(self, x_m: float, y_m: float, z_m: float) -> tuple[int, int]:
        """Pixel of a point x ahead of the camera, y to the left, z above the ground."""
        pitch, drop = CAMERA.pitch_down_rad, CAMERA.height_m - z_m
        depth = x_m * math.cos(pitch) + drop * math.sin(pitch)
        u = CAMERA.cx_px - FOCAL * y_m / depth
        v = CAMERA.cy_px + FOCAL * (drop * math.cos(pitch) - x_m * math.sin(pitch)) / depth
        return round(u), round(v)

    def polygon(self, corners, colour) -> None:
        pixels = np.array([self.point(*corner) for corner in corners], np.int32)
        cv2.fillPoly(self.image, [pixels], colour)

    def strip(self, y0, y1, colour, x0=1.8, x1=400.0) -> None:
        self.polygon([(x0, y0, 0), (x1, y0, 0), (x1, y1, 0), (x0, y1, 0)], colour)

    def _road(self, travelled_m: float) -> None:
        self.strip(-60, 60, (75, 140, 110))
        self.strip(-7.2, 7.2, (165, 170, 172))
        self.strip(-5.25, 5.25, (105, 102, 100))
        for y_m in (-5.0, 5.0):
            self.strip(y_m - 0.07, y_m + 0.07, (230, 230, 230))
        for y_m in (-1.75, 1.75):
            first = 1.8 + (-travelled_m - 1.8) % 9.0
            for x_m in np.arange(first, 120.0, 9.0):
                self.strip(y_m - 0.07, y_m + 0.07, (230, 230, 230), x_m, x_m + 3.0)

    def box(self, x, y, z, colour, side_colour) -> None:
        """The faces of a box that the camera sees; x, y, z are (from, to)."""
        for edge, seen in ((y[0], y[0] > 0), (y[1], y[1] < 0)):
            if seen:
                corners = [(x[0], edge), (x[1], edge)]
                face = [(*c, z[0]) for c in corners] + [(*c, z[1]) for c in corners[::-1]]
                self.polygon(face, side_colour)
        self.plate(x[0], y, z, colour)

    def plate(self, x_m, y, z, colour) -> None:
        """A rectangle across the road."""
        corners = [(y[0], z[0]), (y[1], z[0]), (y[1], z[1]), (y[0], z[1])]
        self.polygon([(x_m, *corner) for corner in corners], colour)

    def ring(self, x_m, y_m, z_m, radius_m, colour) -> None:
        radius_px = round(FOCAL * radius_m / x_m)
        width_px = max(2, round(FOCAL * 0.06 / x_m))
        cv2.circle(self.image, self.point(x_m, y_m, z_m), radius_px, colour, width_px)

    def car(self, x, y) -> None:
        self.box((x, x + 4.4), (y - 0.8, y + 0.8), (0.0, 0.3), (20, 20, 20), (25, 25, 25))
        self.box((x, x + 4.5), (y - 0.9, y + 0.9), (0.2, 0.9), (40, 40, 190), (30, 30, 150))
        cabin = (x + 0.6, x + 3.0)
        self.box(cabin, (y - 0.75, y + 0.75), (0.9, 1.45), (60, 50, 40), (50, 42, 35))

    def truck(self, x, y) -> None:
        self.box((x, x + 8.0), (y - 1.1, y + 1.1), (0.0, 0.9), (25, 25, 25), (20, 20, 20))
        self.box((x, x + 8.0), (y - 1.25, y + 1.25), (0.7, 3.4), (60, 120, 40), (45, 95, 30))

    def pedestrian(self, x, y) -> None:
        for leg in (-0.14, 0.14):
            self.plate(x, (y + leg - 0.09, y + leg + 0.09), (0.0, 0.85), (70, 40, 30))
        self.plate(x, (y - 0.25, y + 0.25), (0.8, 1.5), (40, 60, 210))
        self.plate(x, (y - 0.1, y + 0.1), (1.5, 1.75), (130, 160, 210))

    def cyclist(self, x, y) -> None:
        for wheel in (-0.55, 0.55):
            self.ring(x, y + wheel, 0.34, 0.3, (20, 20, 20))
        self.plate(x, (y - 0.5, y + 0.5), (0.3, 0.6), (40, 150, 60))
        self.plate(x, (y - 0.15, y + 0.15), (0.5, 1.5), (40, 60, 210))
        self.plate(x, (y - 0.1, y + 0.1), (1.5, 1.75), (130, 160, 210))


@pytest.fixture(scope="session")
def draw_frames() -> Callable[..., list[np.ndarray]]:
    """Ten pictures at 10 Hz of one object; x is from the camera to its near end, y to the left.

    The position is that in the last picture, the velocity is over ground, m/s.
    """

    def draw(kind, x_m, y_m, vx_mps, vy_mps, ego_mps=8.0):
        pictures = []
        for step in range(-9, 1):
            t_s = step * 0.1
            canvas = Canvas(ego_mps * t_s, seed=step + 100)
            if kind is not None:
                getattr(canvas, kind)(x_m + (vx_mps - ego_mps) * t_s, y_m + vy_mps * t_s)
            pictures.append(canvas.image)
        return pictures

    return draw


@pytest.fixture
def picture_request(make_request, straight_history) -> Callable[..., Request]:
    """A request with pictures, the camera's geometry, and straight driving at ego_mps."""

    def make(pictures, ego_mps: float | None = 8.0, camera: CameraGeometry | None = CAMERA):
        history = () if ego_mps is None else straight_history(ego_mps)
        jpegs = [encode(picture) for picture in pictures]
        return make_request(jpegs=jpegs, history=history, camera=camera)

    return make
