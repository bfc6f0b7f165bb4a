"""The agreement of one or more persons' observations of a recording (METHOD 4.3)."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

from ssp_core.errors import InputError
from ssp_eval.data.audit import AgreementEntry, Property
from ssp_eval.observations.model import Answers, Observation, leaves

# Two persons mean the same instant if their times differ by no more, or by one frame.
SAME_TIME_S = 0.1
# Of shares that are estimated by eye.
SAME_SHARE = 0.1
_TOLERANCE = 1e-6
UNVERIFIED = "unverified"

Said = TypeVar("Said")
Verdict = Literal["agree", "differ", "one alone", "contradict", "unknown"]


@dataclass(frozen=True)
class Agreement:
    """The part of a recording's observations that counts.

    Args:
        answers: what counts: null where it is unknown or where two differ. Of times within
            the tolerance the mean, of shares the smaller one.
        rows: of all answers that anybody gave. ``one alone``: only one person could tell, or
            looked; ``contradict``: what is left without differing answers can't be together.
        tolerance_s: of times.
    """

    observers: tuple[str, ...]
    observations: tuple[Observation, ...]
    answers: Answers
    rows: tuple[AgreementEntry, ...]
    tolerance_s: float

    @property
    def by(self) -> str:
        """Name the observers for people."""
        return " and ".join(self.observers)

    @property
    def differing(self) -> tuple[str, ...]:
        """Fields on which they differ, which are unverified."""
        return tuple(row.field for row in self.rows if row.verdict in ("differ", "contradict"))

    def statements(self, of: Callable[[Answers], Said | None]) -> list[tuple[str, Said]]:
        """Return an answer with the names of who gave it: of each alone where none counts."""
        if (together := of(self.answers)) is not None:
            return [(self.by, together)]
        return [(one.who, own) for one in self.observations if (own := of(one)) is not None]

    def properties(self) -> dict[str, Property]:
        """Return q(d, k); not determined where they differ or no observer could tell."""
        return self.answers.properties_by(self.by)

    def to_json(self) -> dict[str, Any]:
        """Serialise for programs: observers, their seals, tolerance and rows."""
        return {
            "observers": list(self.observers),
            "seals": [one.seal for one in self.observations],
            "tolerance_s": self.tolerance_s,
            "rows": [row.model_dump() for row in self.rows],
        }


def agree(observations: Sequence[Observation], period_s: float = 0.0) -> Agreement:
    """Compare independent observations of one recording.

    Args:
        observations: at least one, of one recording.
        period_s: between its frames.

    Raises:
        InputError: two are of one person, of different recordings, or name other participants.
        ValueError: there is none.
    """
    if not observations:
        raise ValueError("there is no observation")
    _check_apart(observations)
    tolerance_s = max(SAME_TIME_S, period_s)
    answers = [_answers_of(one) for one in observations]
    merged = json.loads(json.dumps(answers[0]))
    rows: dict[str, AgreementEntry] = {}
    for path, _ in leaves(answers[0]):
        parts = path.split(".")
        values = [_at(one, parts) for one in answers]
        if parts[-1] in ("frames", "note"):
            _set_at(merged, parts, _joined(parts[-1], values))
            continue
        verdict, value = _verdict(values, _kind(path), tolerance_s)
        _set_at(merged, parts, value)
        if parts[-1] != "role" and any(v is not None for v in values):
            rows[path] = AgreementEntry(
                field=path,
                values=[_text(v) for v in values],
                verdict=verdict,
                result=UNVERIFIED if value is None else _text(value),
            )
    # Of answers that one person gave alone, two may not fit together.
    while (wrong := next(Answers.model_validate(merged).contradictions(), None)) is not None:
        path = wrong[0]
        _set_at(merged, path.split("."), None)
        against = {"verdict": "contradict", "result": UNVERIFIED}
        rows[path] = rows[path].model_copy(update=against)
    return Agreement(
        tuple(one.who for one in observations),
        tuple(observations),
        Answers.model_validate(merged),
        tuple(rows.values()),
        tolerance_s,
    )


def _check_apart(observations: Sequence[Observation]) -> None:
    first = observations[0]
    names: dict[str, Observation] = {}
    for one in observations:
        name = " ".join(one.who.casefold().split())
        if name in names:
            raise InputError(
                "looked twice; two observations are independent if two persons made them",
                field="who",
                value=one.who,
                remedy="keep one of the two files",
            )
        names[name] = one
        if one.bag_sha256 != first.bag_sha256:
            raise InputError(
                f"of {one.who} is another recording than that of {first.who}, {first.bag_sha256}",
                field="bag_sha256",
                value=one.bag_sha256,
                remedy="compare observations of one recording",
            )
        if _people(one) != _people(first):
            raise InputError(
                f"of {one.who} are {_people(one)}, those of {first.who} {_people(first)}",
                field="roles.participants",
                remedy="both name the participants by the ids of the K*",
            )


def _people(one: Observation) -> str:
    people = one.roles.participants
    return ", ".join(f"{who} ({people[who].role})" for who in sorted(people))


def _answers_of(one: Observation) -> dict[str, Any]:
    whole = one.model_dump(mode="json", by_alias=True)
    return {name: whole[name] for name in Answers.model_fields}


def _kind(path: str) -> Literal["time", "share", "word"]:
    if path.endswith("_s"):
        return "time"
    return "share" if path.startswith("visibility.") else "word"


def _verdict(
    values: Sequence[Any], kind: Literal["time", "share", "word"], tolerance_s: float
) -> tuple[Verdict, Any]:
    """Judge how answers agree, and what counts; an undecided answer contradicts none."""
    answers = [value for value in values if value is not None]
    if not answers:
        return "unknown", None
    agreed: Verdict = "one alone" if len(answers) == 1 else "agree"
    if kind == "word":
        return (agreed, answers[0]) if all(v == answers[0] for v in answers) else ("differ", None)
    numbers = [{"throughout": 1.0, "never": 0.0}.get(value, value) for value in answers]
    tolerance = tolerance_s if kind == "time" else SAME_SHARE
    if max(numbers) - min(numbers) > tolerance + _TOLERANCE:
        return "differ", None
    return agreed, sum(numbers) / len(numbers) if kind == "time" else min(numbers)


def _at(value: Any, parts: Sequence[str]) -> Any:
    for part in parts:
        value = value[part]
    return value


def _set_at(value: Any, parts: Sequence[str], new: Any) -> None:
    _at(value, parts[:-1])[parts[-1]] = new


def _joined(key: str, values: Sequence[Any]) -> Any:
    """Return evidence and remarks of all observers."""
    if key == "note":
        return "; ".join(dict.fromkeys(v for v in values if v))[:500] or None
    entries = []
    for value in values:
        entries += [item for item in value if item not in entries]
    return entries


def _text(value: Any) -> str:
    if value is None:
        return "unknown"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.3f}".rstrip("0").rstrip(".")
    if isinstance(value, list):
        return ", ".join(str(item) for item in value) or "none"
    return str(value)
