"""The order in which a model is asked about a recording under several conditions.

A model's answers may change with nothing but time: a server warms up, is replaced, or samples. In
a fixed order such a change falls on the same conditions in every recording and looks like an effect
of what they change. So the conditions take turns at each label time, in an order that is drawn and
balanced, and the factual question is asked again at the end (docs/twins.md).
"""

from __future__ import annotations

import json
import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

from ssp_core.hashing import sha256_json
from ssp_eval.evaluate.clients.models import CONDITION_SEED, REPEAT, ModelSpec


@dataclass(frozen=True)
class Stage:
    """Questions that are asked by turns.

    Args:
        models: one model under conditions that the same bridge answers.
        rows: by label time the order in which they are asked, as places in ``models``.
    """

    models: tuple[ModelSpec, ...]
    rows: tuple[tuple[int, ...], ...]


def series_of(models: Sequence[ModelSpec]) -> list[list[ModelSpec]]:
    """Return the models in groups that are asked together.

    One whose factual question is asked again is a group with all its conditions; of the others each
    condition is a group of its own.
    """
    series: list[list[ModelSpec]] = []
    for _, group in groupby(models, lambda model: model.name):
        listed = [*group]
        together = any(model.condition == REPEAT for model in listed)
        series += [listed] if together else [[model] for model in listed]
    return series


def stages_of(
    models: Sequence[ModelSpec], recording_sha256: str, label_times: int
) -> Iterator[Stage]:
    """Yield the stages of a group, in their order.

    The model itself comes first, with all conditions that its bridge answers as it is. Conditions
    that need a bridge with other options follow in an order that is drawn. The repeated question is
    the last. The order depends on the recording and on the names alone, so that a campaign that was
    interrupted goes on in it.

    Args:
        models: one model under its conditions.
        recording_sha256: hash of the recording.
        label_times: of the recording.
    """
    by_bridge: dict[str, list[ModelSpec]] = {}
    for model in models:
        last = model.condition == REPEAT
        key = "" if last else json.dumps(dict(model.options), sort_keys=True, default=str)
        by_bridge.setdefault(key, []).append(model)
    repeats = by_bridge.pop("", [])
    first, *others = by_bridge.values() if by_bridge else [[]]
    names = [model.result_name for model in models]
    rng = random.Random(sha256_json([CONDITION_SEED, "order", recording_sha256, names]))
    rng.shuffle(others)
    for members in (first, *others, repeats):
        if members:
            rows = balanced_rows(len(members), label_times, rng)
            yield Stage(tuple(members), tuple(rows))


def balanced_rows(count: int, rows: int, rng: random.Random) -> list[tuple[int, ...]]:
    """Return orders of some things, in each of which everything stands once.

    They are rows of Williams squares (Australian Journal of Scientific Research A 2:149, 1949)
    whose things and rows are drawn: in each square, of as many rows as things, everything stands at
    every place once, and everything follows everything else equally often; of an odd number in two
    squares together.
    """
    # 0, 1, n−1, 2, n−2, …: neighbours differ by every number once.
    zigzag = [(k + 1) // 2 if k % 2 else -(k // 2) for k in range(count)]
    orders: list[tuple[int, ...]] = []
    while len(orders) < rows:
        things = list(range(count))
        rng.shuffle(things)
        square = [
            tuple(things[(step + shift) % count] for step in zigzag) for shift in range(count)
        ]
        for each in (square, [row[::-1] for row in square]) if count % 2 else (square,):
            rng.shuffle(each)
            orders += each
    return orders[:rows]
