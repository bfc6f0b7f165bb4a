"""A session in one process: what the manager's side asks of the world's, step by step."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from ssp_core.carla.acceptance import ServerOfRun
from ssp_core.cdr.references import Acknowledgement
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.codes import SafetyCode
from ssp_core.value_class import value_class
from ssp_core.vocabulary import SessionPhase
from ssp_core.world.driver import DriveReport, RecordedAnswer
from ssp_core.world.providers import Provider


@value_class(frozen=True, slots=True)
class ManagerUpdate:
    """The manager's messages after a step: one heartbeat, and the references before it.

    Args:
        stamp_ns: session time.
        references: new ones, in the order of dispatch.
    """

    session: SessionPhase
    stamp_ns: int
    references: tuple[Reference, ...] = ()


@dataclass(frozen=True, slots=True)
class LimitFact:
    """A limit that the world or an object saw passed (SafetyEvent.msg)."""

    code: SafetyCode
    source: str
    object_id: str
    measured: float
    limit: float
    stamp_ns: int
    words: str = ""


@dataclass(frozen=True, slots=True)
class FaultFact:
    """An injected fault begins or ends (FaultEvent.msg); its value is NaN where it has none."""

    source: str
    fault: str
    target: str
    active: bool
    value: float
    unit: str
    stamp_ns: int


@dataclass(frozen=True, slots=True)
class LinkFact:
    """The true values of the link to an object; infinite where nothing passes."""

    object_id: str
    offset_s: float
    delay_s: float


@value_class(frozen=True, slots=True)
class StepReport:
    """The messages that reach the manager in one step.

    Args:
        step: of the world, 0 while it holds.
        now_ns: session time.
        running: False: the world holds, before the start or after the end.
        truths: true states of everything, sorted by id.
        vut_states: of the VUT, in the order of arrival.
        target_states: of the object targets, in the order of ids and of arrival.
        acks: answers to references.
        limits: that were seen passed.
        links: what a measurement of the links would find now.
        drive: of the driver of a driven run.
    """

    step: int
    now_ns: int
    running: bool
    truths: tuple[ObjectState, ...]
    vut_states: tuple[ObjectState, ...]
    target_states: tuple[ObjectState, ...]
    acks: tuple[Acknowledgement, ...] = ()
    limits: tuple[LimitFact, ...] = ()
    faults: tuple[FaultFact, ...] = ()
    links: tuple[LinkFact, ...] = ()
    drive: DriveReport | None = None


class Plant(Protocol):
    """The world and all objects of one run."""

    def hold(self, word: ManagerUpdate) -> StepReport:
        """Return the state before the start once more, as the objects report it."""
        ...

    def command(self, object_id: str, command: int, event_version: str) -> str:
        """Take an ObjectCommand; return the reason of a refusal, empty when it was accepted."""
        ...

    def advance(self, word: ManagerUpdate) -> StepReport:
        """Go one step on."""
        ...

    def close(self) -> None:
        """Give back what the plant holds."""
        ...


class SessionCamera(Protocol):
    """The front camera of one run."""

    def picture(
        self,
        step: int,
        stamp_ns: int,
        truths: Sequence[ObjectState],
        jpeg: bytes | None = None,
    ) -> bytes | None:
        """Return the JPEG of a step; None: the step has no frame.

        Args:
            step: each step of the world once, in their order.
            stamp_ns: session time of the step.
            truths: true states of everything.
            jpeg: of the step, where it was drawn already.

        Raises:
            PeerError: the server that draws it refused, or failed.
        """
        ...

    def close(self) -> list[str]:
        """Give everything back; return what couldn't be, in words."""
        ...


OnServer = Callable[[Mapping[str, Any]], None]


def make_camera(run: RunSpec, server: ServerOfRun | None, on_server: OnServer) -> SessionCamera:
    """Return the camera of a run that has one.

    Args:
        run: one that has a camera.
        server: that draws it; None: our own renderer does.
        on_server: takes the record of the server whenever it changes.

    Raises:
        InputError: the run's camera asks a server and none is given.
        HostError: CARLA's client isn't installed.
    """
    camera: SessionCamera = Provider.PLANT.load().make_camera(run, server, on_server)
    return camera


def make_plant(
    run: RunSpec,
    work_dir: Path | None = None,
    answers: Sequence[RecordedAnswer] | None = None,
) -> Plant:
    """Return the world's side of a run.

    Args:
        run: of the session.
        work_dir: for SUMO's files, where there is traffic; None: a temporary folder.
        answers: that the driver of a driven run gave before, and repeats; None: it is asked.
    """
    plant: Plant = Provider.PLANT.load().make_plant(run, work_dir, answers)
    return plant
