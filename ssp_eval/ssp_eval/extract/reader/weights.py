"""The weight of each feature for each label: the file, and the sums.

The weights are whole hundredths, so that a sum is the same on every machine.
``test/train_reader.py`` makes the file.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from math import tanh
from operator import mul
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ssp_eval.extract.reader.candidates import LABELS, Candidate

FILE = Path(__file__).with_suffix(".json")
CLASS = "objects"
# The columns of the weights: for each slot that it says nothing, and its labels; then that a class
# of road users belongs to the set.
COLUMNS = (*(f"{n}:{v}" for n, labels in LABELS.items() for v in ("", *labels)), CLASS)
_SCALE = 100
_DIGITS = 6


@dataclass(frozen=True)
class Weights:
    """The weights of the reader.

    Args:
        rows: the row of each feature.
        table: (features, columns), hundredths.
        bias: of each column, hundredths.
        joining: of each slot, for the numbers of its candidates; the first is the constant.
    """

    rows: Mapping[str, int]
    table: NDArray[np.int32]
    bias: NDArray[np.int32]
    joining: Mapping[str, Sequence[float]]

    def sums(self, features: Iterable[str]) -> NDArray[np.float64]:
        """Sum the weights of a set of features for each column, in natural units."""
        rows = [row for row in map(self.rows.get, features) if row is not None]
        total: NDArray[np.float64] = (self.table[rows].sum(axis=0) + self.bias) / _SCALE
        return total

    def certainty(self, name: str, candidate: Candidate) -> float:
        """Compute how likely a candidate is right, 0 to 1."""
        constant, *weights = self.joining[name]
        return share_of_class(constant + sum(map(mul, weights, candidate.features)))

    def columns(self, name: str) -> slice:
        """Return the columns of a slot."""
        start = next(at for at, one in enumerate(COLUMNS) if one.startswith(f"{name}:"))
        return slice(start, start + 1 + len(LABELS[name]))


def shares_of_labels(sums: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return sums as shares of one along the last axis."""
    powers = np.exp(sums - sums.max(axis=-1, keepdims=True))
    shares: NDArray[np.float64] = powers / powers.sum(axis=-1, keepdims=True)
    return shares.round(_DIGITS)


def share_of_class(total: float) -> float:
    """Return a sum as a share of one."""
    return round(0.5 + 0.5 * tanh(0.5 * total), _DIGITS)


def written(weights: Weights) -> str:
    """Return the weights as their file has them: per line a feature, its columns and hundredths."""
    lines = [
        f"{json.dumps(name)}: {json.dumps(_pairs(weights.table[row]), separators=(',', ':'))}"
        for name, row in sorted(weights.rows.items())
    ]
    head = {
        "columns": list(COLUMNS),
        "bias": [int(one) for one in weights.bias],
        "joining": {name: list(row) for name, row in weights.joining.items()},
    }
    opening = json.dumps(head, indent=1)[:-2]
    return opening + ',\n "features": {\n' + ",\n".join(lines) + "\n}}\n"


def _pairs(row: NDArray[np.int32]) -> list[int]:
    return [int(one) for at in np.flatnonzero(row) for one in (at, row[at])]


@cache
def load_weights() -> Weights:
    """Return the weights of the file, read once."""
    content = json.loads(FILE.read_text(encoding="utf-8"))
    features = content["features"]
    table = np.zeros((len(features), len(COLUMNS)), dtype=np.int32)
    for row, pairs in enumerate(features.values()):
        table[row, pairs[::2]] = pairs[1::2]
    return Weights(
        {name: row for row, name in enumerate(features)},
        table,
        np.array(content["bias"], dtype=np.int32),
        content["joining"],
    )
