"""What a check of a K* says: one failure, with everything that a person needs to mend it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Literal

# form: the file isn't readable as K*; C1–C5: METHOD 1; review: part U and the seals in it.
Check = Literal["form", "C1", "C2", "C3", "C4", "C5", "review"]
Origin = Literal[
    "source video",
    "extraction",
    "contradiction in the structure",
    "platform limit",
    "missing review",
    "open decision",
]


@dataclass(frozen=True, slots=True)
class Failure:
    """One check that doesn't hold.

    Args:
        check: which one.
        field: dotted path of the field, such as ``motion.ot1.trigger.lateral``.
        evidence: the value found, and what it was held against.
        reason: why that is wrong, one clause.
        origin: where it comes from (METHOD 1), or that nobody has decided or reviewed it yet.
        remedy: what would be right.
    """

    check: Check
    field: str
    evidence: str
    reason: str
    origin: Origin
    remedy: str

    def as_dict(self) -> dict[str, str]:
        return asdict(self)


# So many failures with the same reason and remedy are said one by one.
_FEW = 2


def summed_up(failures: Iterable[Failure]) -> list[list[Failure]]:
    """Failures in groups of what one action mends, in the order of the first of each.

    Open decisions are one group; so are more than two failures of a check with the same reason,
    origin and remedy.
    """
    groups: dict[tuple[str, ...], list[Failure]] = {}
    for failure in failures:
        key: tuple[str, ...] = (failure.check, failure.reason, failure.origin, failure.remedy)
        if failure.origin == "open decision":
            key = (failure.origin,)
        groups.setdefault(key, []).append(failure)
    found = []
    for key, group in groups.items():
        few = len(group) <= _FEW and key != ("open decision",)
        found += [[failure] for failure in group] if few else [group]
    return found
