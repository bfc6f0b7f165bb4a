"""The parts that a native prompt and its adapter share: the printed history, earlier stages."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ssp_core.chat.answer_text import split_answer
from ssp_vla_bridge.messages import EgoSample, Request, Response

STEP_S = 0.5  # of all three systems: 2 Hz, as in nuScenes
OPENEMMA_PAIRS = 10
LIGHTEMMA_PAIRS = 6
LLAVIDA_POINTS = 6
CURVATURE_SCALE = 100.0  # OpenEMMA prints hundredths of 1/m

# A sample this far from its place in the 2 Hz raster stands for it; recorders of 10 Hz and more
# come closer.
_OFF_RASTER_S = 0.12
# Three points closer than this per step (0.2 m/s) are noise around a place, which has no curvature.
_AT_REST_M = 0.1
# LightEMMA takes a slower speed for rest, and a stronger curvature for a fault of the poses.
_LIGHTEMMA_REST_MPS = 0.2
_LIGHTEMMA_MOST_CURVATURE_PM = 0.2


@dataclass(frozen=True)
class NativeHistory:
    """Past values of one system, oldest first, rounded as its prompt prints them."""

    rows: tuple[tuple[float, float], ...]
    decimals: int

    @property
    def pairs_text(self) -> str:
        """OpenEMMA's form: ``[5.0,0.1], [5.1,0.0]``."""
        return ", ".join(f"[{self._print(a)},{self._print(b)}]" for a, b in self.rows)

    @property
    def points_text(self) -> str:
        """LLaViDA's form: ``[(0.10,-5.02), (0.03,-2.51)]``."""
        return "[" + ", ".join(f"({self._print(a)},{self._print(b)})" for a, b in self.rows) + "]"

    def column_text(self, column: int) -> str:
        """Write a column as LightEMMA does: ``[10.0, 9.882]``."""
        return "[" + ", ".join(str(row[column]) for row in self.rows) + "]"

    def _print(self, value: float) -> str:
        return f"{value:.{self.decimals}f}"


def openemma_history(request: Request) -> NativeHistory:
    """Return OpenEMMA's ``[v, k]``, up to ten, the last one for the request's time.

    v_i = |p_i − p_(i−1)| in metres per 0.5 s step (half the speed in m/s); k_i = 100 · 4A/(abc) in
    1/m, + is left, of the triangle p_(i−1), p_i, p_(i+1) with signed area A and sides a, b, c. The
    newest k is a copy of the one before: OpenEMMA takes it from the next pose, which a request
    doesn't hold. Where a step is under 0.1 m, k is 0.
    """
    samples = _raster(request, OPENEMMA_PAIRS + 1)
    curvatures = [_curvature_pm(samples[i - 1 : i + 2]) for i in range(1, len(samples) - 1)]
    curvatures.append(curvatures[-1] if curvatures else 0.0)
    rows = [
        (_speed_mps(samples[i - 1], samples[i]) * STEP_S, curvatures[i - 1] * CURVATURE_SCALE)
        for i in range(1, len(samples))
    ]
    return _rounded(rows, 1)


def lightemma_history(request: Request) -> NativeHistory:
    """Return LightEMMA's (v, c), up to six: v in m/s over the next step, c in 1/m at the pose.

    A speed under 0.2 m/s and a curvature over 0.2 1/m are 0, as there; + is left. The newest pair
    is that of the step which ends at the request's time. A pair needs the pose before its step, so
    n samples give n − 2 pairs.
    """
    samples = _raster(request, LIGHTEMMA_PAIRS + 2)
    rows = []
    for i in range(1, len(samples) - 1):
        speed_mps = _speed_mps(samples[i], samples[i + 1])
        curvature_pm = _curvature_pm(samples[i - 1 : i + 2])
        rows.append(
            (
                speed_mps if speed_mps >= _LIGHTEMMA_REST_MPS else 0.0,
                curvature_pm if abs(curvature_pm) <= _LIGHTEMMA_MOST_CURVATURE_PM else 0.0,
            )
        )
    return _rounded(rows, 3)


def llavida_history(request: Request) -> NativeHistory:
    """Return LLaViDA's past positions, up to six, none at present: x to the right, y forward."""
    samples = _raster(request, LLAVIDA_POINTS + 1)[:-1]
    return _rounded([(-sample.y_m, sample.x_m) for sample in samples], 2)


def _raster(request: Request, count: int) -> list[EgoSample]:
    """Return samples at 0, −0.5, −1.0, … s, oldest first, up to the first that is missing."""
    samples = request.history if request.ego_known else ()
    raster_samples: list[EgoSample] = []
    for k in range(count):
        wanted_s = -k * STEP_S
        nearest = min(samples, key=lambda sample: abs(sample.t_s - wanted_s), default=None)
        if nearest is None or not abs(nearest.t_s - wanted_s) <= _OFF_RASTER_S:
            break
        raster_samples.append(nearest)
    return raster_samples[::-1]


def _speed_mps(before: EgoSample, after: EgoSample) -> float:
    distance_m = math.hypot(after.x_m - before.x_m, after.y_m - before.y_m)
    return distance_m / (after.t_s - before.t_s)


def _curvature_pm(samples: Sequence[EgoSample]) -> float:
    """Return the curvature of the circle through three points, 1/m, + is left (Menger)."""
    first, middle, last = ((sample.x_m, sample.y_m) for sample in samples)
    into = (middle[0] - first[0], middle[1] - first[1])
    out = (last[0] - middle[0], last[1] - middle[1])
    across_m = math.dist(first, last)
    into_m, out_m = math.hypot(*into), math.hypot(*out)
    if into_m < _AT_REST_M or out_m < _AT_REST_M or across_m < _AT_REST_M:
        return 0.0
    return 2.0 * (into[0] * out[1] - into[1] * out[0]) / (into_m * out_m * across_m)


def waypoints_history(request: Request) -> NativeHistory:
    """Return all past positions (x forward, y left), as ``waypoints``'s prompt prints them."""
    rows = [(sample.x_m, sample.y_m) for sample in request.history] if request.ego_known else []
    return _rounded(rows, 2)


def _rounded(rows: Sequence[tuple[float, float]], decimals: int) -> NativeHistory:
    # The sum turns −0.0 into 0.0, which would print its sign.
    rounded = [(round(a, decimals) + 0.0, round(b, decimals) + 0.0) for a, b in rows]
    return NativeHistory(tuple(rounded), decimals)


@dataclass(frozen=True)
class Statement:
    """Text of a stage, and the time that it was about, ns."""

    text: str
    stamp_ns: int


def stage_text(response: Response, name: str) -> str | None:
    """Return the raw text of a stage by its span in ``decoding["stages"]``, None without one.

    A span that isn't one, or lies outside the text, names no stage.
    """
    stages = response.decoding.get("stages")
    for stage in stages if isinstance(stages, list) else ():
        if isinstance(stage, Mapping) and stage.get("name") == name:
            start, end = stage.get("start"), stage.get("end")
            if not (isinstance(start, int) and isinstance(end, int)):
                continue
            if 0 <= start <= end <= len(response.text):
                return response.text[start:end]
    return None


def previous_stage(request: Request, name: str) -> Statement | None:
    """Return what the request's earlier answer said in a stage.

    None: nothing, or it wasn't earlier.
    """
    previous = request.previous
    if previous is None or previous.error_code or previous.stamp_ns >= request.stamp_ns:
        return None
    output = stage_text(previous, name)
    text = split_answer(output).text if output else ""
    return Statement(text.strip(), previous.stamp_ns) if text and text.strip() else None
