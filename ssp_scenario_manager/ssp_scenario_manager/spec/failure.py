"""What a check of a K* says: one failure, with everything that a person needs to mend it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Literal

# form: the file isn't readable as K*; C1–C5: METHOD 1; review: part U and the seals in it.
Check = Literal["form", "C1", "C2", "C3", "C4", "C5", "review"]
Origin = Literal["source video", "extraction", "contradiction in the structure", "platform limit"]


@dataclass(frozen=True, slots=True)
class Failure:
    """One check that doesn't hold.

    Args:
        check: which one.
        field: dotted path of the field, such as ``motion.ot1.trigger.lateral``.
        evidence: the value found, and what it was held against.
        reason: why that is wrong, one clause.
        origin: where it comes from (METHOD 1).
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
