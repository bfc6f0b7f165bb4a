"""Corruptions of pictures: what noise, fog or a low sun makes of a frame, the same bytes each time.

Each is a function of one picture, its time and a strength, 1 or 2, and needs nothing but pixels, so
that it can be done to any recording. Sizes are shares of the picture's width or height.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ssp_core.clock import seconds_to_ns
from ssp_core.errors import InputError
from ssp_core.hashing import sha256_json
from ssp_eval.evaluate.clients.models import CONDITION_SEED, DROPPED

Picture = NDArray[np.uint8]  # height × width × 3, BGR
Light = NDArray[np.float32]  # the same with 0 to 1

_JPEG_QUALITY = 90
_PLAIN_QUALITY = 95
_GAMMA = 2.2
_LOST_SPAN_S = 0.3


def _rng(stamp_ns: int, kind: str) -> np.random.Generator:
    """Seed the noise of one picture.

    The strength isn't in it: 2 is the same noise as 1, and stronger.
    """
    digest = sha256_json([CONDITION_SEED, kind, stamp_ns]).removeprefix("sha256:")
    return np.random.Generator(np.random.PCG64(int(digest[:16], 16)))


def _light(values: NDArray[Any]) -> Light:
    return values.astype(np.float32, copy=False)


def _grain(light: Light, sigma: float, rng: np.random.Generator) -> Light:
    """Add sensor noise: shot noise that grows with the root of the light, and some of its own.

    Args:
        light: the picture, shares of full scale.
        sigma: at full light, share of full scale.
        rng: random numbers of the frame.
    """
    random_noise = rng.standard_normal(light.shape, np.float32)
    return _light(light + sigma * np.sqrt(0.15 + 0.85 * light) * random_noise)


def noise(light: Light, strength: int, stamp_ns: int) -> Light:
    """Return the picture of a sensor at high gain."""
    return _grain(light, (0.07, 0.2)[strength - 1], _rng(stamp_ns, "noise"))


def blur(light: Light, strength: int, _stamp_ns: int) -> Light:
    """Return the picture of a lens out of focus: every point becomes a disc."""
    # Small pictures too are to lose something.
    radius_px = max(float(strength), light.shape[1] * (0.0025, 0.0075)[strength - 1])
    half = math.ceil(radius_px)
    y_px, x_px = np.mgrid[-half : half + 1, -half : half + 1]
    # Points at the rim count by the share of them that lies inside.
    disc = np.clip(radius_px + 0.5 - np.hypot(x_px, y_px), 0.0, 1.0)
    # Out of focus light adds up, not its encoded values.
    linear = np.power(light, _GAMMA)
    mixed = cv2.filter2D(linear, -1, disc / disc.sum(), borderType=cv2.BORDER_REFLECT_101)
    return _light(np.power(np.maximum(mixed, 0.0), 1.0 / _GAMMA))


def fog(light: Light, strength: int, _stamp_ns: int) -> Light:
    """Return the picture with mist that thickens towards the middle height.

    A level camera sees the horizon there. The distance is that of level ground below it, and of an
    object nothing is known: what stands on the road is veiled as the ground behind it is.
    """
    height = light.shape[0]
    below = (np.arange(height, dtype=np.float32) + 0.5) / height - 0.5
    # In units of the distance at which the ground lies at the picture's lower edge.
    distance = np.minimum(0.5 / np.maximum(below, 1e-3), 9.0)
    through = np.exp(-(0.09, 0.22)[strength - 1] * distance)[:, None, None]
    # Mist is as bright as the day: the brighter parts of the picture say how bright that is.
    air = float(np.clip(np.percentile(light, 90.0), 0.25, 0.85))
    return _light(light * through + air * (1.0 - through))


def low_light(light: Light, strength: int, stamp_ns: int) -> Light:
    """Return the picture of late dusk at a fixed exposure: less light, bluer, and grain."""
    gain = (0.2, 0.05)[strength - 1]
    tint = np.array([1.15, 1.0, 0.85], np.float32)
    dark = np.power(np.clip(np.power(light, _GAMMA) * gain * tint, 0.0, 1.0), 1.0 / _GAMMA)
    return _grain(dark, (0.03, 0.06)[strength - 1], _rng(stamp_ns, "low_light"))


def glare(light: Light, strength: int, _stamp_ns: int) -> Light:
    """Return the picture with a low sun in front: a white disc, its glow, and a veil over all.

    It stands at the same place in every picture, above the middle and to the right.
    """
    height, width = light.shape[:2]
    y_px, x_px = np.mgrid[:height, :width].astype(np.float32)
    away = np.hypot(x_px - 0.6 * width, y_px - 0.3 * height) / width
    disc = np.clip((0.02 - away) / 0.004 + 1.0, 0.0, 1.0)
    reach, veil = ((0.10, 0.10), (0.24, 0.28))[strength - 1]
    added = disc + 0.85 * np.exp(-away / reach) + veil
    sun = np.array([0.86, 0.95, 1.0], np.float32)
    return _light(light + added[..., None] * sun * (1.0 - 0.5 * light))


Effect = Callable[[Light, int, int], Light]
EFFECTS: dict[str, Effect] = {
    "noise": noise,
    "blur": blur,
    "fog": fog,
    "low_light": low_light,
    "glare": glare,
}


def corrupted(image: Picture, kind: str, strength: int, stamp_ns: int) -> Picture:
    """Return a picture under one of EFFECTS.

    Args:
        image: height × width × 3, BGR.
        kind: one of EFFECTS.
        strength: 1 or 2.
        stamp_ns: of the frame; noise differs from frame to frame.
    """
    light = image.astype(np.float32) / np.float32(255.0)
    output_light = EFFECTS[kind](light, strength, stamp_ns)
    picture: Picture = np.rint(np.clip(output_light, 0.0, 1.0) * 255.0).astype(np.uint8)
    return picture


# Requests of neighbouring label times share frames, and every model is asked with the same ones.
@lru_cache(maxsize=64)
def corrupted_jpeg(jpeg: bytes, kind: str, strength: int, stamp_ns: int) -> bytes:
    """Return a corrupted picture as JPEG, encoded at a fixed quality.

    Raises:
        InputError: it is no picture.
    """
    return _encoded(corrupted(_decoded(jpeg), kind, strength, stamp_ns))


@lru_cache(maxsize=64)
def encoded_again(jpeg: bytes) -> bytes:
    """Return the same picture, decoded and encoded as a corrupted one is.

    Raises:
        InputError: it is no picture.
    """
    return _encoded(_decoded(jpeg))


def plain_like(jpeg: bytes, grey: int) -> bytes:
    """Return a picture of the same size that shows nothing: one grey all over, of 0 to 255.

    Raises:
        InputError: it is no picture.
    """
    height, width = _decoded(jpeg, cv2.IMREAD_GRAYSCALE).shape[:2]
    return _plain(width, height, grey)


@lru_cache(maxsize=8)
def _plain(width_px: int, height_px: int, grey: int) -> bytes:
    return _encoded(np.full((height_px, width_px, 3), grey, np.uint8), _PLAIN_QUALITY)


def is_lost(since_start_ns: int, strength: int) -> bool:
    """Tell whether a frame is lost: links fail in bursts, so that whole spans of time are.

    What is lost at strength 1 is lost at 2 as well.

    Args:
        since_start_ns: time of the frame on the clip's clock.
        strength: 1 or 2.
    """
    digest = sha256_json([CONDITION_SEED, DROPPED, since_start_ns // seconds_to_ns(_LOST_SPAN_S)])
    return int(digest.removeprefix("sha256:")[:8], 16) < (0.4, 0.75)[strength - 1] * 2**32


def _decoded(jpeg: bytes, way: int = cv2.IMREAD_COLOR) -> Picture:
    # Of no bytes at all OpenCV raises an error of its own.
    data = np.frombuffer(jpeg, np.uint8)
    image = cv2.imdecode(data, way) if jpeg else None
    if image is None:
        raise InputError(
            "is no picture", field="frame", remedy="give a recording whose frames can be decoded"
        )
    return image.astype(np.uint8, copy=False)


def _encoded(image: Picture, quality: int = _JPEG_QUALITY) -> bytes:
    success, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not success:
        height, width = image.shape[:2]
        raise ValueError(f"OpenCV can't encode a picture of {width} × {height} px")
    return jpeg.tobytes()
