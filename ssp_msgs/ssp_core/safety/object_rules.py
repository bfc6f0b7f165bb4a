"""The rules of an object, field by field, so that two hosts can compare theirs.

An object has a run file of its own, on its own host. It tells what that file says
(ObjectRules.msg), the manager compares it with its own, and arming names the digest of what was
compared: an object that judges by anything else doesn't arm.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ssp_core import __version__
from ssp_core.geometry import outline_problem
from ssp_core.hashing import sha256_file, sha256_json, sha256_sources
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.fence import lies_inside

# Limits that are stricter where they are lower, and where they are higher. Any other one has no
# side on which it is stricter: an object that stops harder brakes later before its fence, on brakes
# that the site doesn't vouch for, and one that stops more gently needs more room than the plan has.
_LOWER = (
    "trigger_age_s",
    *("speed_mps", "acceleration_mps2", "state_age_s", "heartbeat_s", "ack_s", "duration_s"),
    *("error_longitudinal_m", "error_lateral_m", "error_yaw_rad", "position_std_m", "jump_m"),
    *("frozen_s", "clock_offset_s", "link_delay_s", "start_region_m", "start_yaw_rad"),
    "stop_reaction_s",
)
_HIGHER = ("separation_m",)
_SOFTWARE = "software"
# Sources of this package that an object judges by, and folders of that of the objects, which drive
# it: a host without the second has no objects.
_JUDGES = ("geodesy.py", "geometry.py", "motion", "run_file", "safety")
_OBJECTS = "ssp_ot_controller"
_DRIVES = ("bodies", "control", "objects")
_FENCE = "geofence"


@dataclass(frozen=True, slots=True)
class ObjectRules:
    """Everything that one object judges by.

    Args:
        software: version of the product, and the hash of the sources that judge and drive.
        values: by name of a field of the run file, with dots, as JSON; in the file's order.
    """

    software: str
    values: Mapping[str, str]

    @property
    def digest(self) -> str:
        """Hash of software and values, whatever their order."""
        return sha256_json({_SOFTWARE: self.software, "values": dict(self.values)})


@dataclass(frozen=True, slots=True)
class RulesCheck:
    """The comparison of an object's rules with its manager's.

    Args:
        digest: of what the object judges by; empty: it isn't known.
        problem: the first field that differs, as a sentence; empty: none does that matters.
        stricter: the object's own stricter limits, as clauses.
    """

    digest: str = ""
    problem: str = ""
    stricter: tuple[str, ...] = ()


@cache
def software_here() -> str:
    """Name the product's version and the sources that judge and drive objects.

    They differ between two checkouts.
    """
    package = Path(__file__).parent.parent
    paths = [package / name for name in _JUDGES]
    # Looked up, not imported.
    spec = find_spec(_OBJECTS)
    if spec is not None and spec.submodule_search_locations:
        paths += [Path(spec.submodule_search_locations[0]) / name for name in _DRIVES]
    hashes = [sha256_sources(p) if p.is_dir() else sha256_file(p) for p in paths]
    return f"{__version__}+{sha256_json(hashes).removeprefix('sha256:')[:12]}"


def rules_of(run: RunSpec, object_id: str) -> ObjectRules:
    """Return the rules of an object of a run, by its run file."""
    target = next(one for one in run.targets if one.id == object_id)
    datum = None if run.datum is None else run.datum.model_dump(mode="json")
    size, spec = target.size, target.model_dump(mode="json")
    rules = {
        "event_version": run.event_version,
        "mode": run.mode,
        "step_s": run.step_s,
        "limits": {
            **{name: getattr(run.limits, name) for name in type(run.limits).model_fields},
            "trigger_age_s": run.trigger_age_s,
        },
        _FENCE: run.geofence,
        "datum": datum,
        object_id: {
            **{key: spec[key] for key in ("object_class", "start", "tracker")},
            "size": asdict(size),
            "approach": spec["approach"],
            "manoeuvres": {
                trigger.id: trigger.manoeuvre.model_dump(mode="json")
                for trigger in run.triggers
                if trigger.object_id == object_id
            },
        },
    }
    return ObjectRules(software_here(), dict(_fields("", rules)))


def _fields(name: str, value: Any) -> Iterator[tuple[str, str]]:
    """Yield the leaves below a value; a point of a path is one."""
    if isinstance(value, Mapping) and value:
        for key, below in value.items():
            yield from _fields(f"{name}.{key}" if name else str(key), below)
    elif isinstance(value, list | tuple) and any(isinstance(one, list | tuple) for one in value):
        for index, below in enumerate(value):
            yield from _fields(f"{name}[{index}]", below)
    else:
        yield name, json.dumps(value, allow_nan=False)


def untold(object_id: str) -> RulesCheck:
    """Make the check of an object that hasn't published its rules."""
    return RulesCheck(problem=f"{object_id} has not said what it judges by")


def check_rules(ours: ObjectRules, theirs: ObjectRules | None, object_id: str) -> RulesCheck:
    """Hold what an object says to judge by against what its manager does.

    Args:
        ours: of the manager's run file.
        theirs: as the object sent it; None: it hasn't.
        object_id: of the object, for the text.
    """
    if theirs is None:
        return untold(object_id)
    if theirs.software != ours.software:
        problem = _differs(_SOFTWARE, theirs.software, ours.software, object_id)
        return RulesCheck(theirs.digest, problem)
    stricter = []
    own_fence = _has_fence_inside(ours, theirs)
    for name in (*ours.values, *(name for name in theirs.values if name not in ours.values)):
        mine, its = _value(ours, name), _value(theirs, name)
        if mine == its or (own_fence and name.startswith(f"{_FENCE}[")):
            continue
        if not _is_stricter(name, its, mine):
            return RulesCheck(theirs.digest, _differs(name, its, mine, object_id))
        stricter.append(f"{name} {its} instead of {mine}")
    if own_fence:
        stricter.append(f"{_FENCE}, inside the one here")
    return RulesCheck(theirs.digest, stricter=tuple(stricter))


class ReceivedRules:
    """The rules heard from objects, compared with those of a run."""

    def __init__(self) -> None:
        self._received_rules: dict[str, ObjectRules] = {}
        self._run: RunSpec | None = None
        self._checks: dict[str, RulesCheck] = {}

    def hear(self, statement: tuple[str, ObjectRules]) -> None:
        """Take whose they are, and what an object says to judge by; the newest word counts."""
        object_id, rules = statement
        self._received_rules[object_id] = rules
        self._run = None

    def checks(self, run: RunSpec) -> dict[str, RulesCheck]:
        """Return the check of each object of a run."""
        if run is not self._run:
            ids = [target.id for target in run.targets]
            self._checks = {
                i: check_rules(rules_of(run, i), self._received_rules.get(i), i) for i in ids
            }
            self._run = run
        return self._checks


def _differs(name: str, theirs: str, ours: str, object_id: str) -> str:
    return f"{object_id} judges by another {name}: {theirs} on its host, {ours} here"


def _value(rules: ObjectRules, name: str) -> str:
    """Describe the value of a field, in words where it isn't given or has fields of its own."""
    if (value := rules.values.get(name)) is not None:
        return value
    return "given" if any(one.startswith(f"{name}.") for one in rules.values) else "nothing"


def _has_fence_inside(ours: ObjectRules, theirs: ObjectRules) -> bool:
    """Tell whether an object has another fence of its own, which lies inside the run's."""
    outer, inner = _fence(ours), _fence(theirs)
    return inner != outer and bool(inner) and lies_inside(inner, outer)


def _fence(rules: ObjectRules) -> list[tuple[float, float]]:
    """Return the corners of the fence; empty where it is none that could be in a run file."""
    corner_texts = [value for name, value in rules.values.items() if name.startswith(f"{_FENCE}[")]
    try:
        corners = [(float(x), float(y)) for x, y in map(json.loads, corner_texts)]
    except (ValueError, TypeError):
        return []
    legal = len(corners) >= 3 and all(math.isfinite(x + y) for x, y in corners)
    return corners if legal and outline_problem(corners) is None else []


def _is_stricter(name: str, theirs: str, ours: str) -> bool:
    limit = name.removeprefix("limits.")
    if limit == name or limit not in (*_LOWER, *_HIGHER):
        return False
    try:
        its, mine = float(theirs), float(ours)
    except ValueError:
        return False
    return its < mine if limit in _LOWER else its > mine
