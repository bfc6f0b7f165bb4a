"""``ssp.task/1``: one compiled event, sealed: what was chosen, where, why, and what will run."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, SerializerFunctionWrapHandler, model_serializer

from ssp_core.errors import InputError
from ssp_core.files.folders import TAKEN_FILE, taken_folder
from ssp_core.files.reading import load_model
from ssp_core.files.writing import write_bytes
from ssp_core.hashing import sha256_json
from ssp_core.run_file.model import Limits, LinkDisturbance, RunSpec
from ssp_core.run_file.road import CurvePiece, Lane
from ssp_core.run_file.values import Finite, Outline, Point, Start, Strict, without_defaults

SCHEMA: Literal["ssp.task/1"] = "ssp.task/1"
TASK_FILE = "task.json"
RUN_FILE = "run.yaml"
EVENT_FILE = "event.yaml"
SITE_FILE = "site.yaml"
# Where a session keeps the task that it ran.
TASK_FOLDER = "task"

Target = Literal["sumo", "openscenario", "carla", "track"]


class EventLink(Strict):
    name: str
    version: str


class PlaceLink(Strict):
    """The site or the map that the event was placed on."""

    kind: Literal["site", "opendrive", "sumo"]
    name: str
    sha256: str


class BlockScore(Strict):
    """METHOD 2.2 for one block: scores in [0, 1], and why it was passed over, if it was."""

    block: str
    topology: Annotated[float, Field(ge=0, le=1)]
    interaction: Annotated[float, Field(ge=0, le=1)]
    constraints: Annotated[float, Field(ge=0, le=1)]
    total: Annotated[float, Field(ge=0, le=1)]
    reasons: list[str] = Field([], description="what is missing; empty: fits")
    eligible: bool


class TaskBlock(Strict):
    """The chosen block, whole: a task is read without the map."""

    id: str
    origin: Start
    pieces: list[CurvePiece]
    length_m: Finite
    lanes: list[Lane]


class Place(Strict):
    """A place in the block's frame and in frame map."""

    s_m: Finite
    l_m: Finite
    x_m: Finite
    y_m: Finite


class Anchors(Strict):
    """Start, goal and conflict point of one participant (METHOD 2.3)."""

    start: Place
    goal: Place
    conflict: Place


class TriggerRegion(Strict):
    """Ω_trigger: what fires, and where the VUT is expected to be when it does."""

    quantity: Literal["relative_distance", "time_to_arrival"]
    object_id: str
    below: Finite
    unit: str
    expected: Place = Field(description="the VUT's reference point when it fires, as planned")


class Tuning(Strict):
    """A value that was chosen within part C; a record of L says the same."""

    field: str
    value: Finite
    unit: str
    min: Finite | None
    max: Finite | None
    at_most: Finite | None = Field(
        None, description="what the place allows, where it is less than max; null: all of it"
    )
    reason: str

    @model_serializer(mode="wrap")
    def _without_a_limit_that_is_not_there(
        self, dump: SerializerFunctionWrapHandler
    ) -> dict[str, Any]:
        return without_defaults(dump(self), at_most=None)


NO_TUNINGS: Mapping[str, Tuning] = MappingProxyType({})


class Validation(Strict):
    """The simulation run that validated the anchors (METHOD 2)."""

    run_id: str
    task_version: str
    bag_sha256: str


class Task(Strict):
    """One compiled event. ``version`` is the hash of everything else in it."""

    schema_: Literal["ssp.task/1"] = Field(SCHEMA, alias="schema")
    version: str = ""
    target: Target
    event: EventLink
    compiler: str
    seed: Annotated[int, Field(ge=0, lt=2**31)]
    place: PlaceLink
    block: TaskBlock
    chosen_by: str = Field(description="'highest score', or who chose between ties")
    retrieval: list[BlockScore]
    anchors: dict[str, Anchors]
    vut_route: Annotated[list[Point], Field(min_length=2)]
    trigger: TriggerRegion
    conflict_zone: list[Place]
    limits: Limits
    geofence: Outline
    ot_reachable: list[list[Point]] = []
    safe_stop_zones: list[list[Point]] = []
    tunings: list[Tuning]
    validated_by: Validation | None = None
    run: RunSpec = Field(description="what a session runs; a run adds its id, seed and mode")

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    def tunings_of(self, run: RunSpec) -> Mapping[str, Tuning]:
        """Return the tunings by field; none for a run whose objects were moved by hand since."""
        if (run.targets, run.triggers) != (self.run.targets, self.run.triggers):
            return NO_TUNINGS
        return {tuning.field: tuning for tuning in self.tunings}


def content_hash(task: Task) -> str:
    """Return the hash of everything but the seal itself and the run's copy of it.

    A task of an earlier version of the software was sealed without the fields that came later:
    where what its file says fits its seal, that is its hash.
    """
    as_written = _hash_of(task.model_dump(mode="json", by_alias=True, exclude_unset=True))
    if as_written == task.version:
        return as_written
    return _hash_of(task.model_dump(mode="json", by_alias=True))


def _hash_of(value: dict[str, Any]) -> str:
    value.pop("version", None)
    value["run"].pop("task_version", None)
    return sha256_json(value)


def sealed(task: Task) -> Task:
    """Return the task with its version in it and in its run."""
    version = content_hash(task)
    run = task.run.model_copy(update={"task_version": version})
    return task.model_copy(update={"version": version, "run": run})


def load_task(path: str | Path) -> Task:
    """Read a task file and check its seal.

    Raises:
        InputError: it can't be read, is not valid, or was changed after it was compiled.
    """
    path = Path(path)
    file = path / TASK_FILE if path.is_dir() else path
    task = load_model(Task, file)
    check_seal(task, file)
    return task


def check_seal(task: Task, file: str | Path) -> None:
    """Refuse, with an InputError, a task that was changed after it was compiled."""
    digest = content_hash(task)
    if digest != task.version:
        raise InputError(
            "was changed after it was compiled",
            file=file,
            field="version",
            value=task.version,
            remedy=f"its content has {digest}; compile it again, and enter changes on site in "
            f"{RUN_FILE} with `ssp package log-change`",
        )
    if task.run.task_version != task.version:
        raise InputError(
            "names another task",
            file=file,
            field="run.task_version",
            value=task.run.task_version,
            remedy=f"{task.version} is needed; compile it again",
        )


def as_live(run: RunSpec) -> RunSpec:
    """Return the run in mode live: no disturbances of links and sensors, no simulated traffic.

    What a stand-in site brings of them is for simulation; none of it is a change on site.

    Raises:
        InputError: the site is no proving ground.
    """
    if run.domain != "physical":
        raise InputError(
            "is no proving ground",
            field="site",
            value=run.site,
            remedy="a live session needs a site with domain: physical",
        )
    return run.model_copy(
        update={
            "mode": "live",
            "disturbance": LinkDisturbance(),
            "disturbances": {},
            "traffic": [],
        }
    )


def check_live(run: RunSpec) -> None:
    """Refuse, with an InputError, a live run with faults or disturbances of objects."""
    problem = run.live_problem
    if problem is not None:
        raise InputError(
            problem, field="faults, disturbances", remedy="leave them out, or run in lockstep"
        )


def copy_task(task: Path, folder: Path) -> None:
    """Copy the files of a task into the folder of a run.

    Raises:
        HostError: the disk doesn't take them.
    """
    for file in sorted(task.rglob("*")):
        if file.is_file():
            write_bytes(folder / TASK_FOLDER / file.relative_to(task), file.read_bytes())


@contextmanager
def run_folder(path: Path, task: Path) -> Iterator[Path]:
    """Take a new folder for a run of a task, which is copied into it.

    Nothing is left where the run leaves neither result nor recording, as on a full disk.

    Raises:
        InputError: as ``taken_folder``.
        HostError: the disk doesn't take the task.
    """
    with taken_folder(path, empty=True) as folder:
        try:
            copy_task(task, folder)
            yield folder
        finally:
            if {entry.name for entry in folder.iterdir()} <= {TAKEN_FILE, TASK_FOLDER, RUN_FILE}:
                (folder / RUN_FILE).unlink(missing_ok=True)
                shutil.rmtree(folder / TASK_FOLDER, ignore_errors=True)
