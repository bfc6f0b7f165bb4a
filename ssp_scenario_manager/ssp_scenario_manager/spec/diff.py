"""What differs between two K* files, field by field, in their canonical forms."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from ssp_scenario_manager.spec.fields import get, granules, has
from ssp_scenario_manager.spec.load import canonical
from ssp_scenario_manager.spec.model import Event


@dataclass(frozen=True, slots=True)
class Difference:
    """One field that two K* don't share.

    Args:
        field: its path.
        old: its value in the first one, None where that has no such field.
        new: as old, in the second one.
        unit: of both values, None where they have none or different ones.
        where: which of the two has the field.
    """

    field: str
    old: Any
    new: Any
    unit: str | None
    where: str

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def differences(first: Event, second: Event) -> list[Difference]:
    """Every field that differs, in the order of the files; [] for the same version."""
    old, new = canonical(first), canonical(second)
    # Entries of part U have dots in their keys, so that they are compared apart.
    known = old.pop("uncertainty"), new.pop("uncertainty")
    found: list[Difference] = []
    for path in dict.fromkeys((*granules(old), *granules(new))):
        found += _compare(old, new, path)
    for name in dict.fromkeys((*known[0], *known[1])):
        found += _split(f"uncertainty.{name}", *(side.get(name, _NOTHING) for side in known))
    return found


_NOTHING = object()


def _compare(old: dict[str, Any], new: dict[str, Any], path: str) -> list[Difference]:
    sides = (get(side, path) if has(side, path) else _NOTHING for side in (old, new))
    return _split(path, *sides)


def _split(path: str, before: Any, after: Any) -> list[Difference]:
    """One difference, or one for each field of a cell or an entry that both sides have."""
    if before == after:
        return []
    both = isinstance(before, dict) and isinstance(after, dict)
    if both and "unit" not in before:
        parts = (_split(f"{path}.{key}", before[key], after.get(key, _NOTHING)) for key in before)
        return [item for part in parts for item in part]
    units = {
        value["unit"] for value in (before, after) if isinstance(value, dict) and "unit" in value
    }
    return [
        Difference(
            field=path,
            old=None if before is _NOTHING else before,
            new=None if after is _NOTHING else after,
            unit=units.pop() if len(units) == 1 else None,
            where=_where(before is not _NOTHING, after is not _NOTHING),
        )
    ]


def _where(first: bool, second: bool) -> str:
    return "both" if first and second else ("first" if first else "second")
