"""The report of a probe of a CARLA server (``ssp.carla_probe/1``)."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AwareDatetime, ConfigDict, Field

from ssp_core.carla.frame import BodyBox
from ssp_core.files.reading import load_model
from ssp_core.files.writing import write_json
from ssp_core.run_file.values import Finite, Strict

PROBE_SCHEMA: Literal["ssp.carla_probe/1"] = "ssp.carla_probe/1"


class Outcome(StrEnum):
    """The outcome of a check."""

    PASS = "pass"
    FAIL = "fail"
    # Measured, and judged by nobody.
    INFO = "info"


class Row(Strict):
    """One check.

    Args:
        measured, bound: in ``unit``; null where there is no such number.
        text: what was found, for people.
    """

    check: str
    outcome: Outcome
    measured: Finite | None = None
    bound: Finite | None = None
    unit: str = ""
    text: str = ""


class MeasuredBody(Strict):
    """A blueprint with the box of its actors; see ``BodyBox``.

    Args:
        rests_at_m: height of its origin above the ground after it fell there; null: not tried.
        problem: why no run takes it; empty where one may.
    """

    blueprint: str
    base_type: str
    wheels: int
    length_m: Finite | None = None
    width_m: Finite | None = None
    height_m: Finite | None = None
    forward_m: Finite | None = None
    right_m: Finite | None = None
    up_m: Finite | None = None
    rests_at_m: Finite | None = None
    problem: str = ""

    @property
    def box(self) -> BodyBox | None:
        """The box, where there is one."""
        sides = (self.length_m, self.width_m, self.height_m)
        middle = (self.forward_m, self.right_m, self.up_m)
        numbers = [value for value in (*sides, *middle) if value is not None]
        return BodyBox(*numbers) if len(numbers) == len(sides) + len(middle) else None


class CarlaProbeReport(Strict):
    """The file.

    Args:
        started: UTC.
        settings: of the world, as they were before the probe.
        camera: attributes of the camera that took the pictures.
    """

    schema_: Literal["ssp.carla_probe/1"] = Field(PROBE_SCHEMA, alias="schema")
    host: str
    port: Annotated[int, Field(ge=1, le=65534)]
    version: str
    client_version: str
    started: AwareDatetime
    map_name: str
    map_sha256: str
    settings: dict[str, Any]
    camera: dict[str, str]
    bodies: tuple[MeasuredBody, ...]
    rows: tuple[Row, ...]

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)


def load_report(path: str | Path) -> CarlaProbeReport:
    """Return the report in a file.

    Raises:
        InputError: the file can't be read, or isn't a probe report.
    """
    return load_model(CarlaProbeReport, path)


def write_report(path: str | Path, report: CarlaProbeReport) -> None:
    """Raise InputError or HostError where the file can't be written."""
    write_json(path, report.model_dump(mode="json", by_alias=True))
