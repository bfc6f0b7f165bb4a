"""The recorder of a session in one process, as the manager's side sees it."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from ssp_core.carla.acceptance import ServerOfRun
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import SessionPhase
from ssp_core.world.plant import LimitFact, StepReport
from ssp_core.world.providers import Provider


class SessionRecorder(Protocol):
    """Writes the bag of one session."""

    def hear(self, report: StepReport) -> None:
        """Write what world, VUT and objects say in a step, and the frame of the step."""
        ...

    def answer(self, now_ns: int, session: SessionPhase) -> None:
        """Write what the manager says at the end of each step, after its facts."""
        ...

    def sent(self, object_id: str, reference: bytes, stamp_ns: int) -> None:
        """Write a reference that an object is sent."""
        ...

    def limit(self, passed: LimitFact, reaction: str = "abort") -> None:
        """Write a limit that was passed, and what follows from it."""
        ...

    def take(self, topic: str, message: bytes, stamp_ns: int) -> None:
        """Write one serialised message at its session time; topics as in ssp_core.names."""
        ...

    def close(self) -> None:
        """Give the camera back, attach the recorder's report and close the bag."""
        ...

    @property
    def not_given_back(self) -> list[str]:
        """Words for what a server that drew the frames couldn't be given back at the close."""
        ...


def make_recorder(
    run: RunSpec,
    run_file: Path,
    bag: Path,
    server: ServerOfRun | None = None,
) -> SessionRecorder:
    """Return the recorder of a run.

    Args:
        run: whose camera, if it has one, is drawn.
        run_file: of the run, with its task beside it.
        bag: a new folder.
        server: that draws the camera's frames; None: our own renderer does.

    Raises:
        InputError: the folder exists, or a file of the task can't be taken, or the run asks a
            server and none is given.
        HostError: the disk doesn't take it, or CARLA's client isn't installed.
    """
    recorder: SessionRecorder = Provider.RECORDER.load().make_recorder(run, run_file, bag, server)
    return recorder
