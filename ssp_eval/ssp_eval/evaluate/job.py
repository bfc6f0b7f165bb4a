"""One cell as a piece of work for another process: all that it takes, and what does it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from ssp_core.errors import HostError, InputError
from ssp_core.files import Closing
from ssp_eval.evaluate.admission import NO_AUDIT, Admission
from ssp_eval.evaluate.asker import Askers, WithAnswerers
from ssp_eval.evaluate.campaign import labelled_clip
from ssp_eval.evaluate.cell import CellOptions, evaluate_cell
from ssp_eval.evaluate.cell_file import CellResult
from ssp_eval.evaluate.clip import Clip
from ssp_eval.evaluate.labelled import LabelledClip
from ssp_eval.evaluate.model_spec import ModelSpec
from ssp_eval.evaluate.topics import TopicAskers
from ssp_eval.extract.llm import Extractor
from ssp_eval.labels.model import labels_version
from ssp_eval.score import DEFAULT, Thresholds

ExtractorMaker = Callable[[], Extractor]


@dataclass(frozen=True)
class Settings:
    """What all cells of a campaign have in common; it can be sent to another process.

    Args:
        out: campaign folder.
        adapter, fresh, retry_errors, retry_pause_s: see CellOptions.
        make_extractor: a client of a service can't be sent, so each process makes its own.
        timeout_s: for one answer.
        start_timeout_s: until a bridge is on its topics.
        direct: models answer in the worker itself, without ROS; None: over topics.
        extractor_sha256: of the extractor that all workers must have; empty: any.
        thresholds: of the scorer.
    """

    out: Path
    make_extractor: ExtractorMaker
    adapter: str = ""
    fresh: bool = False
    retry_errors: int = 0
    retry_pause_s: float = 1.0
    timeout_s: float = 60.0
    start_timeout_s: float = 60.0
    direct: Callable[[], Askers] | None = None
    extractor_sha256: str = ""
    thresholds: Thresholds = DEFAULT


@dataclass(frozen=True)
class Job:
    """One cell.

    Args:
        number: its place in the campaign.
        bag: path of the recording.
        labels: path of its labels.
        model: who is asked.
        bag_sha256, labels_sha256: of the recording, and of what its labels say (labels_version).
        admission: what the audit says of the recording.
    """

    number: int
    bag: Path
    labels: Path
    model: ModelSpec
    bag_sha256: str
    labels_sha256: str
    admission: Admission = NO_AUDIT


class JobRunner(Closing):
    """Does jobs one after the other; bridges are kept until the block ends.

    Args:
        settings: of the campaign.
        name: of the worker, for its bridges' output.

    Raises:
        HostError: the worker has another version of the software.
    """

    def __init__(self, settings: Settings, name: str) -> None:
        self._settings = settings
        extractor = settings.make_extractor()
        if settings.extractor_sha256 not in ("", extractor.sha256):
            raise HostError(
                f"{name} extracts by other rules than the campaign ({extractor.sha256}, not "
                f"{settings.extractor_sha256}); install the same version everywhere"
            )
        self._stack = ExitStack()
        if settings.direct is not None:
            self._askers: Askers = settings.direct()
        else:
            logs = settings.out / "logs" / name
            topics = TopicAskers(logs, settings.timeout_s, False, settings.start_timeout_s)
            self._askers = WithAnswerers(self._stack.enter_context(topics))
        self._options = CellOptions(
            settings.adapter,
            settings.fresh,
            settings.retry_errors,
            settings.retry_pause_s,
            extractor,
            settings.thresholds,
        )

    def run(self, job: Job, on_record: Callable[[], None] = lambda: None) -> CellResult:
        """Evaluates a cell as a campaign of one process does.

        Args:
            job: the cell.
            on_record: called once per label time.

        Raises:
            InputError: the recording or its labels aren't those that the campaign began with.
        """
        with Clip(job.bag) as clip:
            labelled = labelled_clip(clip, job.labels, job.admission)
            _check_same(job, labelled)
            return evaluate_cell(
                labelled, job.model, self._askers, self._settings.out, self._options, on_record
            )

    def close(self) -> None:
        """Ends the bridges."""
        self._stack.close()


def _check_same(job: Job, labelled: LabelledClip) -> None:
    """Another machine may hold another file at the same path, and a file may change meanwhile."""
    bag_sha256 = labelled.clip.provenance.bag_sha256
    for file, before, now in (
        (job.bag, job.bag_sha256, bag_sha256),
        (job.labels, job.labels_sha256, labels_version(labelled.labels)),
    ):
        if before != now:
            raise InputError(
                f"isn't what the campaign began with ({before}) but {now}",
                file=file,
                remedy="let it be while a campaign runs, and give all machines the same files",
            )
