"""The reasons for refusing a recording: one table of causes and their consequences (reasons.yaml).

The order of the table is the order of precedence. A finding stands under the first one above it
that may have brought it about; a reason with none above it is a cause of its own, and the first of
these is the primary reason (METHOD 4).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from ssp_core.files.reading import load_model
from ssp_core.run_file.values import Strict


class Meaning(Strict):
    """The meaning of a code: the finding in a few words, and the subject of its check.

    It also names the codes that follow from it where it is found.
    """

    text: str
    check: str
    brings: frozenset[str] = frozenset()


class _Table(Strict):
    groups: dict[str, list[str]]
    codes: dict[str, Meaning]

    def expanded(self) -> dict[str, Meaning]:
        """Return the codes with their groups resolved; a code brings only codes below it."""
        rank = {code: index for index, code in enumerate(self.codes)}
        return {
            code: Meaning(
                text=meaning.text,
                check=meaning.check,
                brings=frozenset(c for c in self._codes(meaning.brings) if rank[c] > rank[code]),
            )
            for code, meaning in self.codes.items()
        }

    def _codes(self, names: Iterable[str]) -> set[str]:
        groups = self.groups
        return {c for n in names for c in (self._codes(groups[n]) if n in groups else {n})}


TABLE = load_model(_Table, Path(__file__).with_suffix(".yaml")).expanded()
_RANK = {code: index for index, code in enumerate(TABLE)}


@dataclass(frozen=True)
class Finding:
    """One thing that keeps a recording out.

    Args:
        code: of the table.
        detail: what was found and what was wanted, with units.
        t_s: clip time at which it happens, for what never happens +inf; None: at no time. A finding
            can't follow from a later one.
    """

    code: str
    detail: str
    t_s: float | None = None

    @property
    def text(self) -> str:
        return TABLE[self.code].text

    @property
    def entry(self) -> dict[str, str]:
        """Return the finding as an audit's file has it."""
        return {"code": self.code, "text": self.text, "detail": self.detail}


@dataclass(frozen=True)
class Reason:
    """A cause, with the findings that follow from it."""

    finding: Finding
    consequences: tuple[Finding, ...]


def explain(findings: Iterable[Finding]) -> tuple[Reason, ...]:
    """Return the causes in order of precedence, each with its consequences (METHOD 4).

    Args:
        findings: in any order; the same one twice counts once.

    Raises:
        KeyError: a code that isn't in the table.
    """
    ranked = sorted(
        dict.fromkeys(findings),
        key=lambda f: (_RANK[f.code], -math.inf if f.t_s is None else f.t_s, f.detail),
    )
    reasons: dict[Finding, list[Finding]] = {}
    root_of: dict[Finding, Finding] = {}
    for finding in ranked:
        cause = next((c for c in root_of if _brings(c, finding)), None)
        if cause is None:
            root_of[finding] = finding
            reasons[finding] = []
        else:
            root_of[finding] = root_of[cause]
            reasons[root_of[cause]].append(finding)
    return tuple(Reason(cause, tuple(rest)) for cause, rest in reasons.items())


def _brings(cause: Finding, finding: Finding) -> bool:
    if cause.code == finding.code:
        # What happens once more doesn't stand beside the first time.
        return cause.t_s is not None and finding.t_s is not None
    if finding.code not in TABLE[cause.code].brings:
        return False
    return cause.t_s is None or finding.t_s is None or cause.t_s <= finding.t_s
