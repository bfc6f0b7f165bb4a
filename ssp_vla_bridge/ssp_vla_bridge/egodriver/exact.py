"""Values to the last bit between a client and a server of ours, beside those of the contract.

Positions and speeds are float32 in the contract's messages. Where both ends are ours, the
metadata of a call carries the same values as they are, so that a bridge behind a server drives as
it does without one. Either end holds them against the contract's values, which stay what counts
for everybody else. A server that can read them says so in its metadata of ``get_version``.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterable, Sequence
from dataclasses import astuple, fields

from ssp_core.motion.trajectory import Trajectory
from ssp_core.world.driver import EgoSample
from ssp_vla_bridge.messages import CameraGeometry

EXACT = "ssp-exact-values"
MOTION = "ssp-motion-bin"
CAMERA = "ssp-camera-bin"
SCHEMA = "ssp.egodriver_answer/1"
# So many samples are carried at most; metadata of 8 KB is what servers take.
_MOST_SAMPLES = 64
# No time of a plan (s) and no place (m) is larger.
_MOST = 1e9
_SAMPLE = struct.Struct("<6d")
_CAMERA = struct.Struct("<8d")
# The contract's float32 lies within this share of a value, or this far from it.
_SHARE, _FAR = 1e-5, 1e-3


def pack_motion(samples: Sequence[EgoSample]) -> bytes:
    """Return the newest samples of a question, oldest first."""
    return b"".join(_SAMPLE.pack(*astuple(one)) for one in samples[-_MOST_SAMPLES:])


def unpack_motion(data: bytes, near: Sequence[EgoSample]) -> tuple[EgoSample, ...]:
    """Read what ``pack_motion`` made.

    Args:
        data: as it came.
        near: the samples of the contract's messages, the last one at the same time.

    Raises:
        ValueError: it is no samples, or others than the contract's.
    """
    if not data or len(data) % _SAMPLE.size:
        raise ValueError("its motion to the last bit has a wrong size")
    samples = tuple(EgoSample(*values) for values in _SAMPLE.iter_unpack(data))
    near_samples = near[-len(samples) :]
    pairs = zip(reversed(samples), reversed(near_samples), strict=False)
    if not all(_are_near(astuple(a), astuple(b)) for a, b in pairs):
        raise ValueError("its motion to the last bit isn't that of its messages")
    return samples


def pack_camera(camera: CameraGeometry) -> bytes:
    """Return the geometry of a camera whose mounting is known."""
    return _CAMERA.pack(*map(float, astuple(camera)))


def unpack_camera(data: bytes, near: CameraGeometry) -> CameraGeometry:
    """Read what ``pack_camera`` made.

    Args:
        data: as it came.
        near: the contract's camera.

    Raises:
        ValueError: it is no camera, or another one than the contract's.
    """
    if len(data) != _CAMERA.size:
        raise ValueError("its camera to the last bit has a wrong size")
    values = dict(zip((one.name for one in fields(near)), _CAMERA.unpack(data), strict=True))
    whole = {name: int(values[name]) for name in ("width_px", "height_px")}
    if not _are_near(values.values(), map(float, astuple(near))):
        raise ValueError("its camera to the last bit isn't that of its messages")
    return CameraGeometry(**{**values, **whole})


def answer_json(text: str, refused: str, plan: Trajectory | None, left_out: str = "") -> bytes:
    """Return what a server of ours says beside the contract's trajectory.

    Args:
        text: of the bridge.
        refused: why there is no plan.
        plan: to the last bit; None: there is none.
        left_out: why its text isn't sent; empty: it is.
    """
    rows = None if plan is None else [plan.t_s, plan.x_m, plan.y_m]
    value = {"schema": SCHEMA, "text": text, "refused": refused, "plan": rows}
    value |= {"left_out": left_out} if left_out else {}
    return json.dumps(value).encode()


def plan_in(value: dict[str, object], near: Trajectory | None) -> tuple[Trajectory | None, str]:
    """Return the plan in what ``answer_json`` made, and why there is none.

    Args:
        value: the object.
        near: the contract's plan; None: it has none.

    Raises:
        ValueError: its plan isn't the contract's.
    """
    rows, refused = value.get("plan"), value.get("refused")
    if rows is None and near is None:
        return None, refused if isinstance(refused, str) else ""
    if not isinstance(rows, list) or len(rows) != 3 or near is None:
        raise ValueError("its plan to the last bit isn't that of its messages")
    try:
        t_s, x_m, y_m = (tuple(float(one) for one in row) for row in rows)
    except (TypeError, OverflowError) as error:
        raise ValueError(f"its plan to the last bit can't be read: {error}") from error
    if not all(abs(value) <= _MOST for value in (*t_s, *x_m, *y_m)):  # NaN neither
        raise ValueError(f"its plan to the last bit has a value beyond {_MOST:g}")
    plan = Trajectory(t_s, x_m, y_m)
    near_places = {t: (x, y) for t, x, y in zip(near.t_s, near.x_m, near.y_m, strict=True)}
    for t, x, y in zip(t_s, x_m, y_m, strict=True):
        # The contract's times are whole microseconds, and it begins at the question.
        there = near_places.get(round(t * 1e6) / 1e6)
        if t > 0.0 and (there is None or not _are_near((x, y), there)):
            raise ValueError("its plan to the last bit isn't that of its messages")
    return plan, ""


def _are_near(values: Iterable[float], near: Iterable[float]) -> bool:
    pairs = zip(values, near, strict=True)
    return all(math.isclose(a, b, rel_tol=_SHARE, abs_tol=_FAR) for a, b in pairs)
