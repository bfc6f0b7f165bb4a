"""Each number of a file from outside has a range, and each unknown key is named with known ones.

The fields are those of the models: a new one is tested without a line here.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from functools import lru_cache
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

import pytest
from pydantic import BaseModel, RootModel, TypeAdapter, ValidationError

from ssp_core.bag.seals.declaration import Declaration
from ssp_core.carla.probe_report import CarlaProbeReport
from ssp_core.errors import InputError
from ssp_core.files.reading import parse_model
from ssp_core.run_file.faults import FaultFile
from ssp_core.run_file.latency import Latency
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.quantities import QUANTITIES, quantity_of
from ssp_core.run_file.shortlist import Shortlist
from ssp_eval.data.audit import Audit
from ssp_eval.data.labels import Labels
from ssp_eval.data.provenance import ImportRecord
from ssp_eval.data.response import ResponseLimits
from ssp_eval.evaluate.clients.models import ModelsFile
from ssp_eval.evaluate.store.results import CellFacts
from ssp_eval.labels.truth import TruthFile
from ssp_eval.observations.model import Observation
from ssp_eval.package.model import Package
from ssp_eval.response.compare import load_limits
from ssp_eval.score.score_file import ScoreFile
from ssp_eval.score.thresholds import ThresholdsFile
from ssp_eval.twins.files import TwinSet
from ssp_ot_controller.bodies.iso22133.probe_report import ProbeReport
from ssp_scenario_manager.closed_loop.campaigns.forms import SealedCards, SealedStarts
from ssp_scenario_manager.closed_loop.campaigns.plan_file import LoopPlan
from ssp_scenario_manager.compile.task import Task
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.extract.clip import Annotation
from ssp_scenario_manager.maps.site import Site

KINDS = {
    "annotation": Annotation,
    "audit": Audit,
    "CARLA probe": CarlaProbeReport,
    "cards": SealedCards,
    "cell": CellFacts,
    "declaration": Declaration,
    "event": Event,
    "faults": FaultFile,
    "import record": ImportRecord,
    "ISO probe": ProbeReport,
    "labels": Labels,
    "loop plan": LoopPlan,
    "models": ModelsFile,
    "observation": Observation,
    "package": Package,
    "response limits": ResponseLimits,
    "run": RunSpec,
    "score": ScoreFile,
    "shortlist": Shortlist,
    "site": Site,
    "starts": SealedStarts,
    "task": Task,
    "thresholds": ThresholdsFile,
    "truth": TruthFile,
    "twins": TwinSet,
}
# Keys beside those that are read may stand in these; the hash of the whole file holds them.
OPEN = {"cards", "truth"}
ABSURD = (1e300, -1e300, math.inf, -math.inf, math.nan)


def members(annotation: Any) -> Iterator[Any]:
    """Yield what an annotation may be, without unions and what is annotated."""
    if get_origin(annotation) is Annotated:
        yield from members(get_args(annotation)[0])
    elif get_origin(annotation) in (Union, UnionType):
        for one in get_args(annotation):
            yield from members(one)
    elif isinstance(annotation, type) and issubclass(annotation, RootModel):
        yield from members(annotation.model_fields["root"].annotation)
    else:
        yield annotation


def fields(form: Any) -> dict[str, Any]:
    """Return the annotations of a model's or a dataclass's fields, by their keys in a file."""
    if isinstance(form, type) and issubclass(form, BaseModel):
        return {info.alias or name: info.annotation for name, info in form.model_fields.items()}
    if dataclasses.is_dataclass(form):
        return {one.name: get_type_hints(form)[one.name] for one in dataclasses.fields(form)}
    return {}


def models(form: Any, known: set[Any] | None = None) -> set[Any]:
    """Return the form of a file, and all models in it."""
    known = set() if known is None else known
    for member in members(form):
        if member in known or member is Latency:  # a text in files
            continue
        if inner := fields(member):
            known.add(member)
        for one in (*inner.values(), *get_args(member)):
            if not isinstance(one, str):
                models(one, known)
    return known


def shapes(annotation: Any, number: float) -> Iterator[Any]:
    """Yield the value that has this number wherever a field may have one."""
    for member in members(annotation):
        origin, args = get_origin(member), get_args(member)
        if member is float:
            yield number
        elif origin is list:
            yield from ([one] * 3 for one in shapes(args[0], number))
        elif origin is tuple:
            for one in shapes(args[0], number):
                yield [one] * (3 if args[-1] is Ellipsis else len(args))
        elif origin is dict:
            yield from ({"a": one} for one in shapes(args[1], number))


adapter = lru_cache(maxsize=None)(TypeAdapter)


def failed(form: Any, key: str, value: Any) -> bool:
    """Tell whether a field refuses a value, whatever else the mapping lacks."""
    try:
        adapter(form).validate_python({key: value})
    except ValidationError as error:
        return any(one["loc"][:1] == (key,) for one in error.errors(include_url=False))
    return False


def numbers(kind: str) -> list[tuple[Any, str, Any]]:
    """List the fields of a kind of file that may hold numbers: model, key, annotation."""
    return [
        (form, key, annotation)
        for form in models(KINDS[kind])
        for key, annotation in fields(form).items()
        if next(shapes(annotation, 1.0), None) is not None
    ]


@pytest.mark.parametrize("kind", KINDS)
def test_no_number_of_a_file_is_absurd(kind: str) -> None:
    taken = [
        (form.__name__, key, value)
        for form, key, annotation in numbers(kind)
        for number in ABSURD
        for value in shapes(annotation, number)
        if not failed(form, key, value)
    ]
    assert not taken


@pytest.mark.parametrize("kind", KINDS)
def test_an_unknown_key_is_refused_with_those_that_are_known(kind: str) -> None:
    closed = [
        form
        for form in models(KINDS[kind])
        if isinstance(form, type)
        and issubclass(form, BaseModel)
        and form.model_config.get("extra") == "forbid"
    ]
    assert closed or kind in OPEN or kind == "labels"
    for form in closed:
        keys = list(fields(form))
        with pytest.raises(InputError) as caught:
            parse_model(form, {f"{keys[0]}x": 1}, "file.yaml")
        error = caught.value
        (one,) = [one for one in error.parts or (error,) if one.field == f"{keys[0]}x"]
        assert one.problem == "is not a known key"
        assert one.remedy is not None
        assert keys[0] in one.remedy


def test_all_kinds_have_numbers_and_the_units_that_are_listed() -> None:
    assert [kind for kind in KINDS if not numbers(kind)] == [
        *("annotation", "declaration", "loop plan")
    ]
    ends = {key for kind in KINDS for _, key, _ in numbers(kind)}
    assert [end for end in QUANTITIES if not any(key.endswith(end) for key in ends)] == []


@pytest.mark.parametrize(
    ("field", "limit", "unit", "says"),
    [
        ("rating", 1.01, "", "a rating is from 0 to 1"),
        ("impact_speed", 351.0, "m/s", "must be from -350 to 350 m/s"),
        ("remaining_distance", 1e9, "m", "must be from -100000000 to 100000000 m"),
        ("ttc_at_braking", 86401.0, "s", "must be from -86400 to 86400 s"),
    ],
)
def test_a_limit_of_a_response_is_within_its_unit(
    field: str, limit: float, unit: str, says: str
) -> None:
    given = load_limits().model_dump(by_alias=True)
    given[field] |= {"limit": limit, "unit": unit}
    with pytest.raises(InputError, match=says) as caught:
        parse_model(ResponseLimits, given, "limits.yaml")
    assert caught.value.field == field


def test_the_longest_unit_counts() -> None:
    assert quantity_of("acceleration_mps2").unit == "m/s^2"
    assert quantity_of("fog_per_m").unit == "1/m"
    assert quantity_of("s_m").unit == "m"
    assert quantity_of("rank").unit == ""
