"""Fixtures shared by the adapters' tests: answers in text, requests with a known 2 Hz history."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import accumulate
from types import SimpleNamespace

import pytest

from ssp_vla_bridge.adapters.adapted import AdaptedResponse
from ssp_vla_bridge.adapters.registry import adapt
from ssp_vla_bridge.messages import EgoSample, Request, Response

NS = 1_000_000_000


def pairs(rows: Sequence[Sequence[float]], form: str = "[{}, {}]", joint: str = ", ") -> str:
    return joint.join(form.format(*row) for row in rows)


NO_HISTORY = Request("r1", 10 * NS, ())


def read(
    adapter: str, text: str, request: Request | None = NO_HISTORY, **kwargs
) -> AdaptedResponse:
    """Adapted from the answer to a request without a history, unless another is given."""
    return adapt(adapter, Response("r1", 10 * NS, "model", "model/1", text, **kwargs), request)


def points(adapted: AdaptedResponse) -> list[tuple[float, float]]:
    trajectory = adapted.trajectory
    return list(zip(trajectory.x_m, trajectory.y_m, strict=True))


def straight_history(steps_m: Sequence[float], step_s: float = 0.5) -> tuple[EgoSample, ...]:
    """Straight driving that covers these distances per step and ends at the origin."""
    travelled = [0.0, *accumulate(steps_m)]
    count = len(travelled)
    return tuple(
        EgoSample((i - count + 1) * step_s, x_m - travelled[-1], 0.0, 0.0, 0.0, 0.0)
        for i, x_m in enumerate(travelled)
    )


def circle_history(radius_m: float, turn_rad: float, count: int) -> tuple[EgoSample, ...]:
    """Samples every 0.5 s on a circle to the left (radius > 0) or right, ending at the origin."""
    samples = []
    for i in range(count):
        angle = (i - count + 1) * turn_rad
        x_m, y_m = abs(radius_m) * math.sin(angle), radius_m * (1 - math.cos(angle))
        samples.append(EgoSample((i - count + 1) * 0.5, x_m, y_m, angle, 0.0, 0.0))
    return tuple(samples)


def request_with(history: tuple[EgoSample, ...], provenance: str = "measured") -> Request:
    return Request("r1", 10 * NS, (), None, history, provenance)


@pytest.fixture(scope="session")
def cases() -> SimpleNamespace:
    """The functions above; test modules can't import each other."""
    return SimpleNamespace(
        pairs=pairs,
        read=read,
        points=points,
        straight_history=straight_history,
        circle_history=circle_history,
        request_with=request_with,
    )
