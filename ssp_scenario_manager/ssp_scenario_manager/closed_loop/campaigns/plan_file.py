"""The file of a campaign: events, drivers, latencies, starts and repeats (ssp.loop/1)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator

from ssp_core.errors import InputError
from ssp_core.files.reading import load_model
from ssp_core.run_file.driven import DriverName
from ssp_core.run_file.latency import ZERO_LATENCY, Latency, LatencyField
from ssp_core.run_file.values import Strict
from ssp_core.world.driver import (
    check_models,
    driver_options,
    history_s_of,
    sees_frames,
    try_driver,
)
from ssp_scenario_manager.compile.targets.folder import check_event
from ssp_scenario_manager.maps.site import load_site

LOOP_SCHEMA: Literal["ssp.loop/1"] = "ssp.loop/1"
# METHOD 8.10: they stand in each campaign. Those that know the truth stand in no rank.
BASELINES = (
    "no_response",
    "constant_velocity",
    "stop_at_once",
    "always_brake",
    "aeb",
    "oracle",
    "careful",
    "built_in",
)
PRIVILEGED = ("aeb", "oracle", "careful", "built_in")
# Their headline is 0 by definition; a campaign in which it isn't measures something else.
ZERO = ("no_response", "stop_at_once", "always_brake")


class CampaignDriver(Strict):
    """A driver of a campaign."""

    driver: DriverName
    options: dict[str, Any] = {}
    label: DriverName | None = Field(None, description="its name in tables; null: the driver's")

    @property
    def display_name(self) -> str:
        """Name in tables."""
        return self.label or self.driver

    @property
    def is_privileged(self) -> bool:
        """Tell whether it knows the truth, whatever its label says."""
        return self.driver in PRIVILEGED

    @property
    def is_model(self) -> bool:
        """Tell whether it answers by frames, and its answers are kept."""
        return sees_frames(self.driver)


class LoopPlan(Strict):
    """A campaign of driven runs."""

    schema_: Literal["ssp.loop/1"] = Field(LOOP_SCHEMA, alias="schema")
    events: Annotated[list[str], Field(min_length=1)]
    site: str = "boulevard"
    drivers: list[CampaignDriver] = Field([], description="beside the baselines")
    models: str | None = Field(
        None, description="ssp.models/1, by its path from the plan; drivers may name its models"
    )
    latencies: Annotated[list[LatencyField], Field(min_length=1)] = [ZERO_LATENCY]
    starts: Annotated[int, Field(ge=1, le=1000)] = Field(20, description="critical ones, per event")
    others: Annotated[int, Field(ge=0, le=1000)] = Field(
        1, description="harmless and unavoidable starts of each event that are run as well"
    )
    repeats: Annotated[int, Field(ge=1, le=100)] = Field(1, description="R, of each driver")
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 1

    @field_validator("events", "latencies")
    @classmethod
    def _no_two_alike(cls, values: list[Any]) -> list[Any]:
        for value in values:
            if values.count(value) > 1:
                raise ValueError(f"{value} stands twice")
        return values

    @field_validator("latencies")
    @classmethod
    def _is_measured_once(cls, values: list[Latency]) -> list[Latency]:
        if sum(one.measured for one in values) > 1:
            raise ValueError("measured is given twice: its bound is no condition of its own")
        return values

    @property
    def everybody(self) -> list[CampaignDriver]:
        """Baselines, then the drivers of the plan."""
        return [*(CampaignDriver(driver=name) for name in BASELINES), *self.drivers]

    @property
    def history_s(self) -> float:
        """Longest history of a driver."""
        return max(history_s_of(one.driver, one.options) for one in self.everybody)

    @property
    def is_measured(self) -> bool:
        """Tell whether a latency is measured, so that its runs go alone on their host."""
        return any(one.measured for one in self.latencies)

    @property
    def room_s(self) -> float:
        """Largest latency, or bound of one, that hand-overs leave time for."""
        return max(one.seconds for one in self.latencies)


@contextmanager
def _at(file: str | Path | None, field: str, value: str) -> Iterator[None]:
    """Name the place in the plan, or the option, of whatever is refused within."""
    try:
        yield
    except InputError as error:
        line = None if error.line is None else f"line {error.line}"
        within = [part for part in (error.file, line, error.field) if part]
        raise InputError(
            error.problem,
            file=file,
            field=": ".join([field, *within]),
            value=value if error.value is None else error.value,
            remedy=error.remedy,
        ) from error


def load_plan(path: str | Path, further: Sequence[CampaignDriver] = ()) -> LoopPlan:
    """Read a campaign's file. No driver is made for it, see ``try_drivers``.

    Args:
        path: of the file.
        further: drivers of the campaign that don't stand in the file.

    Raises:
        InputError: it isn't valid, names no event, site, models or driver, or a driver twice.
    """
    plan = load_model(LoopPlan, path)
    for i, event in enumerate(plan.events):
        with _at(path, f"events[{i}]", event):
            check_event(event)
    with _at(path, "site", plan.site):
        load_site(plan.site)
    models = None
    if plan.models is not None:
        models = Path(path).parent / plan.models
        with _at(path, "models", plan.models):
            check_models(models)
    listed_count = len(plan.drivers)
    drivers = []
    for i, one in enumerate((*plan.drivers, *further)):
        file, field = (
            (path, f"drivers[{i}]") if i < listed_count else (None, f"--drive {one.driver}")
        )
        with _at(file, field, one.driver):
            options = driver_options(one.driver, one.options, models)
        drivers.append(one.model_copy(update={"options": options}))
    plan = plan.model_copy(update={"drivers": drivers})
    names = [one.display_name for one in plan.everybody]
    for i, one in enumerate(plan.drivers):
        if names.count(one.display_name) == 1:
            continue
        is_listed = i < listed_count
        raise InputError(
            "stands twice, or is the name of a baseline",
            file=path if is_listed else None,
            field=f"drivers[{i}]" if is_listed else "--drive",
            value=one.display_name,
            remedy="give it a label of its own"
            if is_listed
            else 'give it another name, such as mine={"backend": …}',
        )
    return plan


def try_drivers(plan: LoopPlan) -> None:
    """Make each driver of a plan once and end it, before a campaign is begun.

    Raises:
        InputError: one can't be loaded.
    """
    for one in plan.drivers:
        try_driver(one.driver, one.options)
