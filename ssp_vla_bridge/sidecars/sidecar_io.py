"""Conversions of sidecars: from a request to a model's inputs, from its arrays to JSON.

Arrays are converted by what numpy arrays and torch tensors have in common (`shape`, `reshape`,
`tolist`), so that neither is imported here. A float32 keeps its exact value.
"""

from __future__ import annotations

import base64
import io
import math
from itertools import pairwise
from typing import Any

from sidecar_service import Json, UnanswerableError

# What is interpolated stays between samples; times carry this much rounding.
TOLERANCE_S = 1e-6


def jpegs(request: Json, count: int, spacing_s: float, tolerance_s: float) -> list[bytes]:
    """Return the newest `count` frames, oldest first.

    Raises:
        UnanswerableError: there are fewer, or they aren't `spacing_s` apart; none is repeated or
            made up.
    """
    frames = request["frames"][-count:]
    if len(frames) < count:
        raise UnanswerableError(f"this model needs {count} frames, the request has {len(frames)}")
    for before, after in pairwise(frames):
        gap_s = (after["stamp_ns"] - before["stamp_ns"]) / 1e9
        if abs(gap_s - spacing_s) > tolerance_s:
            raise UnanswerableError(
                f"this model needs frames {spacing_s:g} s apart, two are {gap_s:.3f} s apart"
            )
    return [base64.b64decode(frame["jpeg_base64"]) for frame in frames]


def decode_jpeg(jpeg: bytes) -> Any:
    """Return the picture, numpy array (height, width, 3) uint8 RGB, by Pillow or else by OpenCV.

    Raises:
        UnanswerableError: it is no whole JPEG.
    """
    import numpy as np

    try:
        from PIL import Image
    except ImportError:
        import cv2

        picture = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
        if picture is None:
            raise UnanswerableError("a frame is no whole JPEG image") from None
        return cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)
    try:
        return np.asarray(Image.open(io.BytesIO(jpeg)).convert("RGB"))
    except OSError as error:
        raise UnanswerableError("a frame is no whole JPEG image") from error


def past_poses(request: Json, count: int, spacing_s: float) -> list[tuple[float, float, float]]:
    """Return the vehicle's (x, y, yaw) at -(count-1)·spacing, …, -spacing, 0 s, oldest first.

    In the ego frame at the request's time: x forward, y left, m; rad. Linear between the samples of
    the history, as the models' own loaders interpolate egomotion.

    Raises:
        UnanswerableError: the history is unknown or doesn't reach back far enough.
    """
    samples = request["history"]
    oldest_s = -(count - 1) * spacing_s
    if not samples or request["ego_provenance"] == "unknown":
        raise UnanswerableError("this model needs the ego history, and the request has none")
    if samples[0]["t_s"] > oldest_s + TOLERANCE_S or samples[-1]["t_s"] < -TOLERANCE_S:
        raise UnanswerableError(
            f"this model needs the ego history from {oldest_s:g} to 0 s, the request has it from "
            f"{samples[0]['t_s']:.3f} to {samples[-1]['t_s']:.3f} s"
        )
    return [_pose(samples, oldest_s + k * spacing_s) for k in range(count)]


def _pose(samples: list[Json], t_s: float) -> tuple[float, float, float]:
    after = next((i for i, s in enumerate(samples) if s["t_s"] >= t_s), len(samples) - 1)
    right = samples[after]
    if after == 0 or right["t_s"] <= t_s:
        return right["x_m"], right["y_m"], right["yaw_rad"]
    left = samples[after - 1]
    weight = (t_s - left["t_s"]) / (right["t_s"] - left["t_s"])
    turn = math.remainder(right["yaw_rad"] - left["yaw_rad"], math.tau)
    return (
        left["x_m"] + weight * (right["x_m"] - left["x_m"]),
        left["y_m"] + weight * (right["y_m"] - left["y_m"]),
        left["yaw_rad"] + weight * turn,
    )


def native_array(
    name: str, values: Any, frame: str, unit: str, step_s: float, first_time_s: float
) -> Json:
    """Return a numpy array or torch tensor in the JSON form of `ssp.vla_http/1`.

    Numbers that aren't finite stand as the strings nan, inf and -inf.
    """
    for method in ("detach", "cpu"):  # of torch only
        if hasattr(values, method):
            values = getattr(values, method)()
    return {
        "name": name,
        "shape": [int(size) for size in values.shape],
        "data": [_number(value) for value in values.reshape(-1).tolist()],
        "frame": frame,
        "unit": unit,
        "step_s": step_s,
        "first_time_s": first_time_s,
    }


def _number(value: float) -> float | str:
    return float(value) if math.isfinite(value) else str(float(value))


def texts(values: Any) -> Any:
    """Return a numpy string array, or lists of strings, as nested lists of plain strings."""
    plain = values.tolist() if hasattr(values, "tolist") else values
    if isinstance(plain, (list, tuple)):
        return [texts(one) for one in plain]
    return str(plain)


def first_text(values: Any) -> str:
    """Return the text of the first sample."""
    while isinstance(values, list):
        if not values:
            return ""
        values = values[0]
    return str(values)
