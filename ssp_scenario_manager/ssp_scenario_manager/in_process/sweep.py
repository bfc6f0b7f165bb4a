"""Many runs of one event in one process each, with values that vary: one CSV row per run."""

from __future__ import annotations

import csv
import io
import json
import multiprocessing
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ssp_core.console import ignore_stop_signals
from ssp_core.errors import HostError, InputError
from ssp_core.files import read_mapping, write_bytes, write_json, write_text
from ssp_core.hashing import sha256_json
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import Phase
from ssp_scenario_manager.in_process.outcome import InProcessResult, run_in_process
from ssp_scenario_manager.in_process.vary import Variable, Variation, values_of
from ssp_scenario_manager.runner.happened import rounded

SWEEP_FILE = "sweep.json"
ROWS_FILE = "runs.csv"
_SCHEMA = "ssp.sweep/1"
_MEASURED = (
    "verdict", "reason", "trigger_s", "conflict_s", "resolution_s", "initiator_first",
    "time_gap_s", "min_distance_m", "error_longitudinal_rms_m", "error_lateral_rms_m", "session_s",
)  # fmt: skip
Row = list[str]


@dataclass(frozen=True, slots=True)
class Sweep:
    """What is run.

    Args:
        spec: the run; its seed is that of run 0, the following ones count up.
        variations: what differs.
        runs: how many.
    """

    spec: RunSpec
    variations: tuple[Variation, ...]
    runs: int

    @property
    def header(self) -> Row:
        return ["run", "seed", *(v.field for v in self.variations), *_MEASURED]

    def check(self) -> None:
        """Raises InputError where a value makes no valid run."""
        Variable(self.spec).check(self.variations)

    def record(self) -> dict[str, Any]:
        """What a folder's rows were made of; the same for more or fewer runs of the same sweep."""
        same = self.spec.model_copy(update={"run_id": ""}).model_dump(mode="json", by_alias=True)
        return {
            "schema": _SCHEMA,
            "scenario": self.spec.scenario,
            "site": self.spec.site,
            "seed": self.spec.seed,
            "run": sha256_json(same),
            "vary": [str(v) for v in self.variations],
        }


def is_sweep(folder: Path) -> bool:
    """True for a folder that a sweep has begun to fill."""
    return (folder / SWEEP_FILE).is_file()


def run_sweep(sweep: Sweep, folder: Path, jobs: int, on_row: Callable[[Row], None]) -> list[Row]:
    """Runs what isn't there yet, and leaves ``runs.csv`` with one row per run.

    A row is written when it and all before it are there, so that a sweep that was interrupted goes
    on where it was. The file's bytes don't depend on ``jobs``, and no row is ever taken out of it.

    Args:
        sweep: what to run.
        folder: new, or of the same sweep.
        jobs: processes that share the work.
        on_row: is called for each row, those that were there included.

    Returns:
        The rows of these runs, without the header.

    Raises:
        InputError: the folder holds another sweep.
    """
    there = _begin(sweep, folder)
    rows = there[: sweep.runs]
    for row in rows:
        on_row(row)
    path = folder / ROWS_FILE
    write_bytes(path, _lines([sweep.header, *there]).encode())
    todo = range(len(rows), sweep.runs)
    with _mapper(sweep, min(jobs, len(todo))) as run_all, path.open("a", newline="") as stream:
        for row in run_all(todo):
            stream.write(_lines([row]))
            stream.flush()
            rows.append(row)
            on_row(row)
    return rows


def _begin(sweep: Sweep, folder: Path) -> list[Row]:
    """The rows that are there already, whole ones in order."""
    record = sweep.record()
    if not is_sweep(folder):
        run = sweep.spec.model_dump_json(by_alias=True, indent=1)
        write_text(folder / "run.yaml", run + "\n")
        write_json(folder / SWEEP_FILE, record)
        return []
    found = read_mapping(folder / SWEEP_FILE)
    for key, value in record.items():
        if found.get(key) != value:
            raise InputError(
                "holds another sweep",
                file=folder,
                field=key,
                value=found.get(key),
                remedy=f"this one has {json.dumps(value)}; name another folder with --out",
            )
    return _whole_rows(sweep, folder / ROWS_FILE)


def _whole_rows(sweep: Sweep, path: Path) -> list[Row]:
    if not path.is_file():
        return []
    text = path.read_bytes().decode("utf-8", errors="replace")
    # The last line may have been cut off by whatever ended the sweep.
    lines = list(csv.reader(io.StringIO(text[: text.rfind("\n") + 1])))
    rows = []
    for number, row in enumerate(lines[1:]):
        if lines[0] != sweep.header or row[:2] != [str(number), str(sweep.spec.seed + number)]:
            raise InputError("isn't as the sweep left it", file=path, line=number + 2, value=row)
        rows.append(row)
    return rows


def _lines(rows: Iterable[Sequence[str]]) -> str:
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows(rows)
    return stream.getvalue()


# -- one run -----------------------------------------------------------------------------------


class _Worker:
    """Runs of one process: the run file is read once, and the road's network made once."""

    def __init__(self, sweep: Sweep) -> None:
        self._sweep = sweep
        self._variable = Variable(sweep.spec)
        self._work_dir = tempfile.TemporaryDirectory(prefix="ssp-sweep-")

    def row(self, number: int) -> Row:
        seed = self._sweep.spec.seed + number
        values = values_of(self._sweep.variations, self._sweep.spec.seed, number)
        spec = self._variable.with_values(values, seed)
        result, _ = run_in_process(spec, Path(self._work_dir.name))
        return [str(number), str(seed), *map(str, values.values()), *_measured(result)]

    def close(self) -> None:
        self._work_dir.cleanup()


def _measured(result: InProcessResult) -> Row:
    phases = [result.phase_s(p) for p in (Phase.TRIGGER, Phase.CONFLICT, Phase.RESOLUTION)]
    first = result.passing.other_first
    numbers = (
        result.passing.time_gap_s,
        result.min_distance_m,
        *result.error_rms_m,
        result.session_s,
    )
    return [
        result.verdict.name.lower(),
        result.reasons[0] if result.reasons else "",
        *map(_shown, phases),
        "" if first is None else str(first).lower(),
        *map(_shown, numbers),
    ]


def _shown(value: float | None) -> str:
    kept = rounded(value)
    return "" if kept is None else str(kept)


# -- sharing the work --------------------------------------------------------------------------

_worker: _Worker | None = None


def _start_worker(sweep: Sweep) -> None:
    global _worker
    ignore_stop_signals()
    _worker = _Worker(sweep)


def _row_of_worker(number: int) -> Row:
    if _worker is None:
        raise RuntimeError("the worker was not started")
    return _worker.row(number)


@contextmanager
def _mapper(sweep: Sweep, jobs: int) -> Iterator[Callable[[range], Iterator[Row]]]:
    """A map from run numbers to rows that keeps the order."""
    if jobs <= 1:
        worker = _Worker(sweep)
        try:
            yield lambda numbers: map(worker.row, numbers)
        finally:
            worker.close()
        return
    # A fresh interpreter each: libsumo holds one simulation per process and doesn't like forks.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, context, _start_worker, (sweep,)) as pool:
        try:
            yield lambda numbers: pool.map(_row_of_worker, numbers)
        except BrokenProcessPool as error:
            raise HostError(
                "a process of the sweep was killed; the same command goes on where it was"
            ) from error
        finally:
            pool.shutdown(cancel_futures=True)
