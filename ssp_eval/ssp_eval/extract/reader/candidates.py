"""The values that a slot may have, and what speaks for each over the whole text.

The clauses say how likely each label is in each of them; this joins them with what the rules read.
The last step is one weighted sum for each candidate, so that any answer can be taken apart.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import log
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ssp_eval.data.records import SLOT_NAMES, VOCABULARIES, Slots

LABELS: Mapping[str, tuple[str, ...]] = {
    name: tuple(VOCABULARIES[name]) for name in SLOT_NAMES if name != "objects"
}
_SURE = 0.5  # that a clause says something of a slot
_LONG = 20  # clauses
_LEAST = 1e-3


class Candidate(NamedTuple):
    """A value with what speaks for it.

    Args:
        value: a label, or for objects a set of classes in order.
        features: the numbers that the weights are for.
        clause: the clause that speaks for it most; -1 for objects.
    """

    value: str | tuple[str, ...]
    features: list[float]
    clause: int


def of_labels(name: str, shares: NDArray[np.float64], slots: Slots) -> list[Candidate]:
    """Return the labels of a slot.

    Args:
        name: any slot but objects.
        shares: (clauses, 1 + labels), how likely each clause says nothing, or each label.
        slots: what the rules read.
    """
    labels = LABELS[name]
    label_shares = shares[:, 1:]
    count = len(shares)
    most: list[float] = label_shares.max(axis=0).tolist()
    any_of: list[float] = (1.0 - np.prod(1.0 - label_shares, axis=0)).tolist()
    whole, whole_of = sum(most) + 1e-9, sum(any_of) + 1e-9
    loudest: list[int] = label_shares.argmax(axis=0).tolist()
    saying = np.flatnonzero(label_shares.sum(axis=1) > _SURE)
    last = int(saying[-1]) if len(saying) else -1
    slot = getattr(slots, name)
    rule_value = slot.value if slot is not None else None
    candidates = []
    for at, label in enumerate(labels):
        rival = max(most[:at] + most[at + 1 :])
        rivals = max(any_of[:at] + any_of[at + 1 :])
        clause = loudest[at]
        same, none = float(rule_value == label), float(rule_value is None)
        odds, against = _odds(most[at]), _odds(rival)
        kinds = [float(other == at) for other in range(len(labels))]
        features = [
            odds,
            _odds(any_of[at]),
            against,
            _odds(rivals),
            most[at],
            any_of[at],
            rival,
            rivals,
            most[at] / whole,
            any_of[at] / whole_of,
            float(clause == last),
            clause / max(count - 1, 1),
            float(label_shares[last, at]) if last >= 0 else 0.0,
            *_rules(none, same, slots),
            log(count),
            min(count, _LONG) / _LONG,
            *kinds,
            *(kind * same for kind in kinds),
            *(kind * odds for kind in kinds),
            same * odds,
            same * against,
            none * against,
            none * odds,
            none * log(count),
            same * log(count),
        ]
        candidates.append(Candidate(label, features, clause))
    return candidates


def of_classes(shares: Mapping[str, float], slots: Slots, count: int) -> list[Candidate]:
    """Return sets of road users: the likeliest one, and that of the rules.

    Args:
        shares: how likely each class that is named belongs to the set.
        slots: what the rules read.
        count: clauses of the text.
    """
    rule_classes = slots.objects.value if slots.objects is not None else None
    likely = tuple(sorted(name for name, share in shares.items() if share > _SURE))
    sets = [
        one
        for one in dict.fromkeys([likely, rule_classes])
        if one is not None and (one or rule_classes == ())
    ]
    candidates = []
    for one in sets:
        odds = [_odds(p) if name in one else -_odds(p) for name, p in shares.items()]
        same, none = float(one == rule_classes), float(rule_classes is None)
        least, total = min(odds, default=0.0), sum(min(one, 0.0) for one in odds)
        features = [
            least,
            total,
            same * least,
            none * least,
            float(one == likely),
            *_rules(none, same, slots),
            log(count),
            float(len(shares) > 1),
            float(len(shares) > 2),
            float(len(one) > 1),
            float(not one),
            float(len(one) > 1) * same,
            float(not one) * same,
            none * log(count),
            same * log(count),
        ]
        candidates.append(Candidate(tuple(one), features, -1))
    return candidates


def _odds(share: float) -> float:
    return log((share + _LEAST) / (1.0 - share + _LEAST))


def _rules(none: float, same: float, slots: Slots) -> list[float]:
    """Encode the rules' reading as numbers."""
    classes = slots.objects.value if slots.objects is not None else None
    filled = [float(getattr(slots, name) is not None) for name in SLOT_NAMES]
    single = float(classes is not None and len(classes) == 1)
    return [none, same, float(not none and not same), *filled, single, float(classes == ())]
