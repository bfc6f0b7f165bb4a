"""Many runs of one event in one process each, with values that vary: one CSV row per run."""

from __future__ import annotations

import csv
import difflib
import io
import itertools
import json
import multiprocessing
import re
import tempfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np

from ssp_core import console
from ssp_core.clock import ns_to_seconds
from ssp_core.errors import HostError, InputError
from ssp_core.files import (
    make_folder,
    parse_model,
    read_mapping,
    write_bytes,
    write_json,
    write_text,
)
from ssp_core.hashing import sha256_json
from ssp_core.run_file.model import RunSpec
from ssp_core.terminal import ignore_stop_signals
from ssp_core.vocabulary import Phase
from ssp_scenario_manager.run.faults import RUNNER_KINDS, with_conditions_never_met
from ssp_scenario_manager.run.in_process import (
    InProcessResult,
    result_json,
    run_in_process,
    save_states,
)
from ssp_scenario_manager.run.result import rounded, shown_gap

OPTION = "--vary"
# A run has one of each; what a sweep is of must stay the same over its rows.
_FIXED = ("schema", "run_id", "seed", "mode", "camera", "look")
_WORDS = {"true": True, "false": False, "null": None}


@dataclass(frozen=True, slots=True)
class Choice:
    """These values in turn."""

    field: str
    values: tuple[Any, ...]

    def __str__(self) -> str:
        return f"{self.field}={','.join(map(_word, self.values))}"


@dataclass(frozen=True, slots=True)
class Span:
    """A number between two bounds, drawn evenly for each run."""

    field: str
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.field}={self.low}:{self.high}"

    @property
    def ends(self) -> tuple[float, float]:
        return self.low, self.high

    def draw(self, seed: int, run: int) -> float:
        """The value of one run: a function of seed, field and run alone."""
        random = np.random.default_rng([seed, zlib.crc32(self.field.encode()), run])
        return self.low + (self.high - self.low) * float(random.random())


Variation = Choice | Span


def parse_variation(text: str) -> Variation:
    """``driver.cruise_mps=11:15`` (evenly between), or ``disturbance.reorder=0,0.1`` (in turn).

    Raises:
        InputError: no such form, or bounds that are no rising numbers.
    """
    field, equals, values = text.partition("=")
    field = field.strip()
    if not (equals and field and values.strip()):
        raise InputError(
            "is no FIELD=VALUES",
            field=OPTION,
            value=text,
            remedy="give one such as driver.cruise_mps=11:15 or disturbance.reorder=0,0.1",
        )
    if ":" in values:
        low, high = (_scalar(part, text) for part in _bounds(values, text))
        if not (_is_number(low) and _is_number(high) and low < high):
            raise InputError(
                "needs a lower and an upper bound", field=OPTION, value=text, remedy="such as 11:15"
            )
        return Span(field, float(low), float(high))
    return Choice(field, tuple(_scalar(part, text) for part in values.split(",")))


def _bounds(values: str, text: str) -> list[str]:
    parts = values.split(":")
    if len(parts) != 2:
        raise InputError(
            "has more than two bounds", field=OPTION, value=text, remedy="such as 11:15"
        )
    return parts


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _scalar(part: str, text: str) -> Any:
    """A number, true, false, null, or a word."""
    word = part.strip()
    if word in _WORDS:
        return _WORDS[word]
    for kind in (int, float):
        with suppress(ValueError):
            return kind(word)
    if not re.fullmatch(r"[\w.+/-]+", word):
        raise InputError(
            f"{word!r} is no number or word", field=OPTION, value=text, remedy="such as 0.05"
        )
    return word


def _word(value: Any) -> str:
    """As ``_scalar`` reads it."""
    return next((word for word, known in _WORDS.items() if known is value), str(value))


def grid(variations: Sequence[Variation]) -> list[dict[str, Any]]:
    """Every combination of the values that are taken in turn; the last one changes fastest."""
    choices = [v for v in variations if isinstance(v, Choice)]
    return [
        {choice.field: value for choice, value in zip(choices, values, strict=True)}
        for values in itertools.product(*(choice.values for choice in choices))
    ]


def values_of(variations: Sequence[Variation], seed: int, run: int) -> dict[str, Any]:
    """What one run has for each varied field, in the order in which they were given.

    Args:
        run: number of the run, from 0.
    """
    cells = grid(variations)
    cell = cells[run % len(cells)]
    return {
        v.field: v.draw(seed, run) if isinstance(v, Span) else cell[v.field] for v in variations
    }


class Variable:
    """A run of which single fields can be given other values."""

    def __init__(self, spec: RunSpec) -> None:
        self._spec = spec
        self._data = spec.model_dump(mode="json", by_alias=True)

    def with_values(self, values: dict[str, Any], seed: int) -> RunSpec:
        """The run with these values.

        Args:
            values: by dotted path, such as ``driver.cruise_mps`` or ``triggers.0.lead_time_s``.

        Raises:
            InputError: no such field, naming those that are near; or no valid value of it.
        """
        data: dict[str, Any] = {**self._data, "seed": seed}
        for field, value in values.items():
            data = _replaced(data, field.split("."), value, lambda f=field: self._unknown(f))
        shown = ", ".join(f"{field}={value}" for field, value in values.items())
        return parse_model(RunSpec, data, f"the run with {shown}" if shown else "the run")

    def check(self, variations: Sequence[Variation]) -> None:
        """Refuses what can't be varied, before the first run of a sweep.

        Raises:
            InputError: as ``with_values``, or a field that is given twice or belongs to the sweep.
        """
        seen: set[str] = set()
        for variation in variations:
            field = variation.field
            if field in seen:
                raise InputError(
                    "is varied twice", field=OPTION, value=field, remedy="merge the two"
                )
            if field.split(".")[0] in _FIXED:
                raise InputError(
                    "can't be varied: it is the same over a sweep, or the sweep's own",
                    field=OPTION,
                    value=field,
                )
            seen.add(field)
            ends: tuple[Any, ...]
            ends = variation.values if isinstance(variation, Choice) else variation.ends
            for value in ends:
                self.with_values({field: value}, self._spec.seed)

    def _unknown(self, field: str) -> InputError:
        known = list(_leaves(self._data))
        last = field.split(".")[-1]
        near = [f for f in known if f.split(".")[-1] == last]
        near += [f for f in difflib.get_close_matches(field, known, 4, 0.6) if f not in near]
        remedy = f"did you mean {', '.join(near[:4])}?" if near else "see run.yaml of any run"
        return InputError("is no single field of a run", field=OPTION, value=field, remedy=remedy)


def _leaves(value: Any, path: str = "") -> Iterator[str]:
    """Dotted paths of all single values."""
    if isinstance(value, dict):
        items: Iterator[tuple[Any, Any]] = iter(value.items())
    elif isinstance(value, list):
        items = enumerate(value)
    else:
        yield path
        return
    for key, inner in items:
        yield from _leaves(inner, f"{path}.{key}" if path else str(key))


def _replaced(value: Any, path: Sequence[str], new: Any, unknown: Any) -> Any:
    """The value with a single one in it replaced; everything on the way is copied."""
    if not path:
        if isinstance(value, dict | list):
            raise unknown()
        return new
    key = path[0]
    if isinstance(value, dict) and key in value:
        return {**value, key: _replaced(value[key], path[1:], new, unknown)}
    if isinstance(value, list) and key.isdecimal() and int(key) < len(value):
        copy = list(value)
        copy[int(key)] = _replaced(value[int(key)], path[1:], new, unknown)
        return copy
    raise unknown()


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


# Of the faults that the runner injects, the session itself can do these.
_IN_PROCESS = ("operator_abort", "trigger_never")


def for_one_process(spec: RunSpec) -> RunSpec:
    """The run as it is done in one process: without a camera, and with triggers that fail.

    Raises:
        InputError: a fault needs processes of their own.
    """
    for index, fault in enumerate(spec.faults):
        if fault.kind in RUNNER_KINDS and fault.kind not in _IN_PROCESS:
            raise InputError(
                f"{fault.kind} needs processes of their own",
                field=f"faults[{index}].kind",
                remedy="leave out --in-process, or this fault",
            )
    return with_conditions_never_met(spec.model_copy(update={"camera": None}))


def run_one(spec: RunSpec, folder: Path, as_json: bool) -> dict[str, Any]:
    """One run; leaves run.yaml, states.npz and result.json. Gives what stands in the last.

    Args:
        spec: as ``for_one_process`` gives it.
        folder: is there.
        as_json: the result on standard output as JSON.
    """
    write_text(folder / "run.yaml", spec.model_dump_json(by_alias=True, indent=1) + "\n")
    result, record = run_in_process(spec)
    for line in _told(spec, result):
        console.note(line)
    written = result_json(spec, result)
    # Said first: the disk may be full.
    if as_json:
        click.echo(json.dumps(written))
    else:
        shown = shown_gap(written["time_gap_s"])
        console.out.print(
            f"{spec.scenario} on {spec.site}: {written['verdict']}, {result.session_s:.1f} s of "
            f"session, {shown}, {folder / 'result.json'}",
            markup=False,
        )
        for reason in result.reasons:
            console.out.print(f"  because {reason}", markup=False)
    save_states(folder / "states.npz", spec, record)
    write_json(folder / "result.json", written)
    return written


def _told(spec: RunSpec, result: InProcessResult) -> list[str]:
    """What happened and when, and faults that were asked for and never came."""
    lines = [
        (p.stamp_ns, f"phase {p.phase.name.lower()} at {ns_to_seconds(p.stamp_ns):.2f} s")
        for p in result.phases
    ]
    lines += [
        (
            f.stamp_ns,
            f"FAULT {f.fault.partition(' ')[2]} of {f.target} {'begins' if f.active else 'ends'} "
            f"({ns_to_seconds(f.stamp_ns):.2f} s)",
        )
        for f in result.faults
    ]
    begun = {f.fault for f in result.faults}
    late = [
        f"fault {i}, {fault.kind} of {fault.target}, did not begin: the run ended before "
        f"{fault.at_s:g} s"
        for i, fault in enumerate(spec.faults)
        if fault.kind not in RUNNER_KINDS and fault.at_s is not None
        if f"{i} {fault.kind}" not in begun
    ]
    return [text for _, text in sorted(lines, key=lambda line: line[0])] + late


def run_many(
    spec: RunSpec, folder: Path, vary: tuple[str, ...], runs: int | None, jobs: int, as_json: bool
) -> int:
    """A sweep; leaves run.yaml, sweep.json and runs.csv. Exit status 0 when all runs are valid."""
    spec = for_one_process(spec)
    variations = tuple(parse_variation(text) for text in vary)
    if runs is None and any(isinstance(v, Span) for v in variations):
        raise InputError(
            "a range has no number of values",
            field="--vary",
            value=", ".join(vary),
            remedy="say with --runs how many are drawn",
        )
    sweep = Sweep(spec, variations, runs if runs is not None else len(grid(variations)))
    sweep.check()
    make_folder(folder)
    verdicts: Counter[str] = Counter()
    reasons: Counter[str] = Counter()
    with console.progress("runs", sweep.runs) as bar:

        def count(row: Row) -> None:
            verdicts[row[sweep.header.index("verdict")]] += 1
            if reason := row[sweep.header.index("reason")]:
                # Up to the name of the limit; what was measured differs from run to run.
                reasons[reason.partition(":")[0]] += 1
            bar.advance(bar.task_ids[0])

        rows = run_sweep(sweep, folder, jobs, count)
    if as_json:
        click.echo(json.dumps([dict(zip(sweep.header, row, strict=True)) for row in rows]))
    else:
        parts = ", ".join(f"{count} {name}" for name, count in sorted(verdicts.items()))
        console.out.print(
            f"{spec.scenario} on {spec.site}: {len(rows)} runs, {parts}, {folder / ROWS_FILE}",
            markup=False,
        )
        for reason, count_of in sorted(reasons.items()):
            console.out.print(f"  {count_of} because {reason}", markup=False)
    return 0 if set(verdicts) <= {"valid"} else 1
