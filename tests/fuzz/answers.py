"""Answers of models: texts and stored responses, and the adapters that read them."""

from __future__ import annotations

import json
from collections.abc import Iterator

from ssp_core.errors import InputError
from ssp_vla_bridge.adapters.adapted import AdaptedResponse
from ssp_vla_bridge.adapters.registry import ADAPTERS, adapt
from ssp_vla_bridge.messages import (
    EgoSample,
    NativeArray,
    Request,
    Response,
    response_from_json,
    response_to_json,
)
from ssp_vla_bridge.native_history import openemma_history
from ssp_vla_bridge.trajectory import INVALID_REASONS, check_trajectory

NAMES = [f"{name}:{mode}" for name, adapter in ADAPTERS.items() for mode in adapter.modes]
HISTORY = tuple(
    EgoSample(0.5 * i, 5.0 * i + 0.2 * i * i, 0.0, 0.0, 0.0, 0.0) for i in range(-10, 1)
)
REQUEST = Request("r", 0, (), None, HISTORY, "measured")
_REQUESTS = (None, REQUEST, Request("r", 0, ()))


def answer(data: bytes) -> None:
    """A text to an adapter, both chosen by the first byte, with or without a request."""
    if not data:
        return
    which, request = divmod(data[0] % (len(NAMES) * len(_REQUESTS)), len(_REQUESTS))
    text = data[1:].decode("utf-8", "replace")
    _sound(adapt(NAMES[which], Response("r", 0, "m", "m", text), _REQUESTS[request]))


def response(data: bytes) -> None:
    """A stored response, to all adapters."""
    try:
        raw = response_from_json(json.loads(data))
    except (InputError, ValueError, RecursionError):
        return
    for name in NAMES:
        _sound(adapt(name, raw, REQUEST))


def _sound(adapted: AdaptedResponse) -> None:
    """Raises AssertionError for what is neither a valid trajectory nor a reason why not."""
    if (adapted.trajectory is None) != bool(adapted.invalid):
        raise AssertionError(f"{adapted.trajectory} with {adapted.invalid}")
    if set(adapted.invalid) - set(INVALID_REASONS):
        raise AssertionError(f"{adapted.invalid} are no reasons")
    if adapted.trajectory is not None and check_trajectory(adapted.trajectory):
        raise AssertionError(f"{adapted.trajectory} is called valid")


def texts() -> Iterator[bytes]:
    """Texts as models write them, to each adapter."""
    echo = openemma_history(REQUEST).pairs_text
    pairs = ", ".join(f"[{3.4 - 0.1 * i:.1f}, -0.{i}]" for i in range(10))
    points = ",".join(f"(-0.{i},{3 * i}.5)" for i in range(1, 7))
    written = (
        f"The past is {echo}.\n</think>\n\nFuture: {pairs}\n\nSo, finally:\n{pairs}",
        f"{echo}, {pairs}",
        "1. t=0.5s: (v=3.2 m/s, c=\u22120.2)\n2. t=1.0s: (v=3.1 m/s, c=.1)\n3. t=1.5s: (4., 1e-3)",
        f"Correct action: [['STRAIGHT','STOP']]\n**3-second trajectory:** [{points}]",
        f"Historical trajectory: [{points}]\n3-second trajectory: [{points[:20]}",
        "Trajectory: [[4.0, 0.1], [7.5, nan], ..., [10.5, -0.2]]",
        "[['Keep distance since it\\'s ahead.' \"it's\"]]",
        '```json\n[{"speed": 3.2, "curvature": 0.1}, {"speed": 3 km/h, "curvature": 0}]\n```',
    )
    for text in written:
        for first in range(0, len(NAMES) * len(_REQUESTS), 2):
            yield bytes([first]) + text.encode()


def stored() -> Iterator[bytes]:
    """Responses with the arrays of each interface."""
    rows = NativeArray(
        "trajectory", (3, 2), (4.0, 0.0, 7.5, 0.1, 9.0, 0.2), "ego_xy", "m", 0.5, 0.5
    )
    path = tuple(float(i) for i in range(36))
    xyz = NativeArray("pred_xyz", (1, 1, 1, 12, 3), path, "ego_xyz", "m", 0.1, 0.1)
    stages = {"stages": [{"name": "motion", "start": 6, "end": 38}]}
    text = "Scene. [5.0, 0.1], [5.1, 0.0], [5.0, 0.2]"
    for raw in (
        Response("r", 0, "m", "m", text, (rows, xyz), stages),
        Response("r", 0, "m", "m", "['Stop.']", (xyz,), {}, 0.5, 2, "it broke"),
    ):
        yield json.dumps(response_to_json(raw)).encode()
