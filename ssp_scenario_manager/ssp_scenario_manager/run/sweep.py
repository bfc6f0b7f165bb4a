"""Many runs of one event in one process each, with values that vary: one CSV row per run."""

from __future__ import annotations

import csv
import io
import json
import math
import re
import tempfile
import zlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import click
import numpy as np

from ssp_core import console
from ssp_core.bag.seals.verdict import leave_verdict
from ssp_core.carla.acceptance import ServerOfRun
from ssp_core.clock import ns_to_seconds
from ssp_core.compiled import core_in_use
from ssp_core.decimals import decimal, whole_number
from ssp_core.errors import InputError
from ssp_core.files.folders import taken_folder
from ssp_core.files.reading import parse_model
from ssp_core.files.writing import write_json, write_text
from ssp_core.run_file.model import RunSpec, load_run
from ssp_core.run_file.verdict import RESULT_FILE
from ssp_core.vocabulary import Phase
from ssp_core.world.driver import RecordedAnswer
from ssp_scenario_manager.run.faults import NEED_PROCESSES, RUNNER_KINDS, with_conditions_never_met
from ssp_scenario_manager.run.in_process import (
    InProcessResult,
    Record,
    result_json,
    run_in_process,
    run_recorded,
    save_states,
)
from ssp_scenario_manager.run.ordered_map import ordered_map
from ssp_scenario_manager.run.result import late_conflict, rounded, time_gap_text
from ssp_scenario_manager.triggers.on_route import off_route

OPTION = "--vary"
# A run has one of each; what a sweep is of must stay the same over its rows.
_FIXED = ("schema", "run_id", "seed", "mode", "camera", "look")
_WORDS = {"true": True, "false": False, "null": None}


@dataclass(frozen=True, slots=True)
class Variation:
    """The values that one field of the run file is given.

    Args:
        field: its dotted path, such as ``driver.cruise_mps`` or ``triggers.0.lead_time_s``.
        values: taken in turn; of a drawn one its lower and upper bound.
        is_drawn: a number between the bounds is drawn for each run.
    """

    field: str
    values: tuple[Any, ...]
    is_drawn: bool = False

    def draw(self, seed: int, run: int) -> float:
        """Draw the value of one run, a function of seed, field and run alone."""
        random = np.random.default_rng([seed, zlib.crc32(self.field.encode()), run])
        low, high = self.values
        return float(low + (high - low) * float(random.random()))


def parse_variation(text: str) -> Variation:
    """Parse ``driver.cruise_mps=11:15`` (drawn), or ``disturbance.reorder=0,0.1`` (in turn).

    Raises:
        InputError: no such form, or bounds that are no rising numbers.
    """
    field, _, values = text.partition("=")
    field = field.strip()
    if not (field and values.strip()):
        raise InputError(
            "is no FIELD=VALUES",
            field=OPTION,
            value=text,
            remedy="give one such as driver.cruise_mps=11:15 or disturbance.reorder=0,0.1",
        )
    if ":" not in values:
        return Variation(field, tuple(_scalar(part, text) for part in values.split(",")))
    with suppress(ValueError):
        low, high = map(decimal, values.split(":"))
        if low < high and math.isfinite(high - low):
            return Variation(field, (low, high), is_drawn=True)
    raise InputError(
        "needs a lower and an upper bound", field=OPTION, value=text, remedy="such as 11:15"
    )


def _scalar(part: str, text: str) -> Any:
    """Read a number, true, false, null, or a word."""
    word = part.strip()
    if word in _WORDS:
        return _WORDS[word]
    for kind in (whole_number, decimal):
        with suppress(ValueError):
            return kind(word)
    if not re.fullmatch(r"[\w.+/-]+", word):
        raise InputError(
            f"{word!r} is no number or word", field=OPTION, value=text, remedy="such as 0.05"
        )
    return word


def combinations(variations: Sequence[Variation]) -> int:
    """Count the combinations of the values that are taken in turn."""
    return math.prod(len(v.values) for v in variations if not v.is_drawn)


def values_of(variations: Sequence[Variation], seed: int, run: int) -> dict[str, Any]:
    """Return the value that one run has for each varied field, in their given order.

    Of values that are taken in turn the last field's change fastest.

    Args:
        variations: in the order in which they were given.
        seed: of the sweep.
        run: number of the run, from 0.
    """
    cell, at = dict[str, Any](), run
    for v in reversed(variations):
        if not v.is_drawn:
            at, place = divmod(at, len(v.values))
            cell[v.field] = v.values[place]
    return {v.field: v.draw(seed, run) if v.is_drawn else cell[v.field] for v in variations}


def with_values(spec: RunSpec, values: dict[str, Any], seed: int) -> RunSpec:
    """Return the run with other values of single fields, by their dotted paths.

    Raises:
        InputError: no such field, naming those that are there; or no valid value of it.
    """
    data: dict[str, Any] = {**spec.model_dump(mode="json", by_alias=True), "seed": seed}
    for field, value in values.items():
        *way, last = field.split(".")
        holder: Any = data
        for key in way:
            holder = holder[_key(holder, key, field)]
        single = _key(holder, last, field)
        if isinstance(holder[single], dict | list):
            raise _no_single_field(holder[single], field)
        holder[single] = value
    values_text = ", ".join(f"{field}={value}" for field, value in values.items())
    return parse_model(RunSpec, data, f"the run with {values_text}" if values_text else "the run")


def _value(spec: RunSpec, field: str) -> Any:
    """Return the JSON value of a field of the run."""
    json_value: Any = spec.model_dump(mode="json", by_alias=True)
    for key in field.split("."):
        json_value = json_value[_key(json_value, key, field)]
    return json_value


def _key(holder: Any, key: str, field: str) -> Any:
    """Return the key or index of a part of a value that was read from a file."""
    if isinstance(holder, dict) and key in holder:
        return key
    if isinstance(holder, list) and key.isdecimal() and int(key) < len(holder):
        return int(key)
    raise _no_single_field(holder, field)


def _no_single_field(holder: Any, field: str) -> InputError:
    keys = range(len(holder)) if isinstance(holder, list) else holder
    single = not isinstance(holder, dict | list)
    remedy = "see run.yaml" if single else f"there is {', '.join(map(str, keys))}"
    return InputError("is no single field of a run", field=OPTION, value=field, remedy=remedy)


ROWS_FILE = "runs.csv"
_MEASURED = (
    "verdict",
    "reason",
    "trigger_s",
    "conflict_s",
    "resolution_s",
    "initiator_first",
    "time_gap_s",
    "min_distance_m",
    "error_longitudinal_rms_m",
    "error_lateral_rms_m",
    "session_s",
)
Row = list[str]


@dataclass(frozen=True, slots=True)
class Sweep:
    """A series of runs.

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

    def values(self, run: int) -> dict[str, Any]:
        """Return the varied values of a run."""
        return values_of(self.variations, self.spec.seed, run)

    def begin_row(self, run: int) -> Row:
        """Begin a run's row with the values known before it was run."""
        return [str(run), str(self.spec.seed + run), *map(str, self.values(run).values())]

    def check(self) -> None:
        """Refuse what can't be varied, and each run that can't be made, before the first run.

        Raises:
            InputError: as ``with_values``; a field that is given twice or belongs to the sweep; a
                start or a path that lies off its route.
        """
        fields = [v.field for v in self.variations]
        for variation in self.variations:
            field = variation.field
            if fields.count(field) > 1:
                raise InputError(
                    "is varied twice", field=OPTION, value=field, remedy="merge the two"
                )
            if field.split(".")[0] in _FIXED:
                raise InputError(
                    "can't be varied: it is the same over a sweep, or the sweep's own",
                    field=OPTION,
                    value=field,
                    remedy="vary another field",
                )
            if variation.is_drawn:
                for bound in variation.values:
                    with_values(self.spec, {field: bound}, self.spec.seed)
        # Values that are sound by themselves may not be so together, nor the other way round.
        for run in range(self.runs):
            values = self.values(run)
            for problem in off_route(with_values(self.spec, values, self.spec.seed + run)):
                values_text = ", ".join(f"{field}={value}" for field, value in values.items())
                raise InputError(
                    f"run {run}: {problem}",
                    field=OPTION,
                    value=values_text,
                    remedy="angles are rad; change starts and paths together, and compile for "
                    "another place",
                )


def is_sweep(folder: Path) -> bool:
    """Tell whether a sweep has begun to fill this folder."""
    return (folder / ROWS_FILE).is_file()


def run_sweep(sweep: Sweep, folder: Path, jobs: int, on_row: Callable[[Row], None]) -> list[Row]:
    """Write ``run.yaml`` and ``runs.csv`` with one row per run, as soon as the rows before are.

    The file's bytes don't depend on ``jobs``. Runs whose rows are there aren't run again.

    Args:
        sweep: run, variations and their number.
        folder: empty, or of the same sweep, of which no row is taken out.
        jobs: processes that share the work.
        on_row: is called for each row, those that were there included.

    Returns:
        The rows without the header.

    Raises:
        InputError: the folder holds another sweep.
    """
    there = _rows_there(sweep, folder) if is_sweep(folder) else []
    write_text(folder / "run.yaml", sweep.spec.model_dump_json(by_alias=True, indent=1) + "\n")
    write_text(folder / ROWS_FILE, _lines([sweep.header, *there]))
    rows = there[: sweep.runs]
    for row in rows:
        on_row(row)
    todo = range(len(rows), sweep.runs)
    with (
        ordered_map(min(jobs, len(todo))) as run_all,
        (folder / ROWS_FILE).open("a", newline="") as stream,
    ):
        for row in run_all(partial(_row, sweep), todo):
            stream.write(_lines([row]))
            stream.flush()
            rows.append(row)
            on_row(row)
    return rows


def _rows_there(sweep: Sweep, folder: Path) -> list[Row]:
    """Return the rows that an earlier call left, without one that was cut off."""
    other = partial(InputError, "holds another sweep", remedy="name a new folder with --out")
    if load_run(folder / "run.yaml").model_copy(update={"run_id": sweep.spec.run_id}) != sweep.spec:
        raise other(file=folder / "run.yaml")
    path = folder / ROWS_FILE
    text = path.read_bytes().decode(errors="replace")
    lines = list(csv.reader(io.StringIO(text[: text.rfind("\n") + 1])))
    for number, row in enumerate(lines, -1):
        begin = sweep.header if number < 0 else sweep.begin_row(number)
        if len(row) != len(sweep.header) or row[: len(begin)] != begin:
            raise other(file=path, line=number + 2, value=",".join(row))
    return lines[1:]


def _lines(rows: list[Row]) -> str:
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows(rows)
    return stream.getvalue()


def _row(sweep: Sweep, number: int) -> Row:
    spec = with_values(sweep.spec, sweep.values(number), sweep.spec.seed + number)
    result, _ = run_in_process(spec, Path(_work_dir().name))
    return [*sweep.begin_row(number), *_measured(result)]


@cache
def _work_dir() -> tempfile.TemporaryDirectory[str]:
    """Make this process's folder, in which the road's network is made once."""
    return tempfile.TemporaryDirectory(prefix="ssp-sweep-")


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
        *map(_cell_text, phases),
        "" if first is None else str(first).lower(),
        *map(_cell_text, numbers),
    ]


def _cell_text(value: float | None) -> str:
    number = rounded(value)
    return "" if number is None else str(number)


def for_one_process(spec: RunSpec, *, camera: bool = False) -> RunSpec:
    """Return the run as it is done in one process: no token, and with triggers that fail.

    Args:
        spec: the run.
        camera: the run is recorded, and keeps its camera.

    Raises:
        InputError: a fault needs processes of their own, or the run CARLA's physics.
    """
    for index, fault in enumerate(spec.faults):
        if fault.kind in NEED_PROCESSES:
            raise InputError(
                f"{fault.kind} needs processes of their own",
                field=f"faults[{index}].kind",
                remedy="leave out --in-process, or this fault",
            )
    if spec.plant == "carla":
        raise InputError(
            "a run in one process moves our own bodies only",
            field="plant",
            value=spec.plant,
            remedy="leave out --in-process, or give --plant bodies",
        )
    camera_spec = spec.camera if camera else None
    return with_conditions_never_met(
        spec.model_copy(update={"camera": camera_spec, "session_token": ""})
    )


# What else result.json says of a run, and why its verdict can't stand; empty: it can.
Further = Callable[[RunSpec, InProcessResult, Record], tuple[dict[str, Any], str]]


def _nothing_further(_: RunSpec, __: InProcessResult, ___: Record) -> tuple[dict[str, Any], str]:
    return {}, ""


def run_one(
    spec: RunSpec,
    folder: Path,
    as_json: bool,
    *,
    recorded: bool = False,
    server: ServerOfRun | None = None,
    further: Further = _nothing_further,
    answers: Sequence[RecordedAnswer] | None = None,
) -> dict[str, Any]:
    """Do one run, which leaves run.yaml, states.npz and result.json; return the last's content.

    Args:
        spec: as ``for_one_process`` gives it.
        folder: is there.
        as_json: the result on standard output as JSON.
        recorded: it leaves a bag too.
        server: that draws the bag's frames; None: our own renderer does.
        further: returns what else ``result.json`` says of the run, and why its verdict can't
            stand.
        answers: that the model of a driven run gave before, and repeats; None: it is asked.
    """
    run_file = folder / "run.yaml"
    write_text(run_file, spec.model_dump_json(by_alias=True, indent=1) + "\n")
    if recorded:
        bag = folder / "bag"
        result, record, bag_fields = run_recorded(
            spec, run_file, bag, console.note, server, answers
        )
    else:
        (result, record), bag_fields = run_in_process(spec, answers=answers), {}
    more, why = further(spec, result, record)
    if why:
        result = result.failed_for(why)
        if recorded:
            bag_fields["seal"] = leave_verdict(bag, result.verdict, result.reasons, "runner")
    result_fields = result_json(spec, result) | bag_fields | {"compiled_core": core_in_use()} | more
    # Said first: the disk may be full.
    _say(spec, folder, result, result_fields, as_json)
    save_states(folder / "states.npz", spec, record)
    write_json(folder / RESULT_FILE, result_fields)
    return result_fields


def _say(
    spec: RunSpec,
    folder: Path,
    result: InProcessResult,
    result_fields: dict[str, Any],
    as_json: bool,
) -> None:
    """Print what a run did."""
    for line in _event_lines(spec, result):
        console.note(line)
    if as_json:
        click.echo(json.dumps(result_fields))
    else:
        gap_text = time_gap_text(result_fields["time_gap_s"])
        console.out.print(
            f"{spec.scenario} on {spec.site}: {result_fields['verdict']}, {result.session_s:.1f} s "
            f"of session, {gap_text}, {folder / RESULT_FILE}",
            markup=False,
        )
        for reason in result.reasons:
            console.out.print(f"  because {reason}", markup=False)
        warn_of_late_conflict(result_fields)
        if "driven" in result_fields:
            say_driven(result_fields["driven"])


def warn_of_late_conflict(result_fields: Mapping[str, Any]) -> None:
    """Print that a run's conflict came too long after its trigger.

    Args:
        result_fields: as ``result.json`` has it.
    """
    starts = {phase["phase"]: phase["at_s"] for phase in result_fields["phases"] or ()}
    if warning := late_conflict(starts.get("trigger"), starts.get("conflict")):
        console.out.print(f"  warning: {warning}", markup=False)


def say_driven(driven: dict[str, Any]) -> None:
    """Print what became of a driven run.

    Args:
        driven: as ``result.json`` has it.
    """
    heading = f"  {driven['driver']}: {driven['outcome']} at {driven['outcome_s']:.2f} s"
    console.out.print(f"{heading}, {driven['why']}", markup=False)
    if (measured := driven["measured"]) is not None and not measured["answers"]:
        console.out.print("  L: – (nothing was asked)", markup=False)
    elif measured is not None:
        console.out.print(
            f"  L of {measured['answers']} answers: median {measured['p50_s']:.3f} s, p99 "
            f"{measured['p99_s']:.3f} s, {measured['over_bound']} above the bound of "
            f"{measured['bound_s']:g} s",
            markup=False,
        )
    if driven["left_out"]:
        parts = " and ".join(driven["left_out"])
        console.out.print(f"  without {parts}, which no driven session has", markup=False)
    if driven["needless"]:
        console.out.print(f"  needless without the event: {driven['needless']}", markup=False)


def _event_lines(spec: RunSpec, result: InProcessResult) -> list[str]:
    """List the events of a run and their times, and requested faults that never came."""
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
    """Do a sweep, which leaves run.yaml and runs.csv; exit status 0 when all runs are valid."""
    spec = for_one_process(spec)
    variations = tuple(parse_variation(text) for text in vary)
    if runs is None and any(v.is_drawn for v in variations):
        raise InputError(
            "a range has no number of values",
            field="--vary",
            value=", ".join(vary),
            remedy="say with --runs how many are drawn",
        )
    sweep = Sweep(spec, variations, runs if runs is not None else combinations(variations))
    sweep.check()
    for variation in variations:
        separator = " to " if variation.is_drawn else ", "
        values = separator.join(f"{value}" for value in variation.values)
        was = _value(spec, variation.field)
        console.note(f"changed on site: {variation.field} {was!r} → {values}")
    verdicts: Counter[str] = Counter()
    reasons: Counter[str] = Counter()
    with console.progress("runs", sweep.runs) as bar:

        def count(row: Row) -> None:
            verdicts[row[sweep.header.index("verdict")]] += 1
            if reason := row[sweep.header.index("reason")]:
                # Up to the name of the limit; what was measured differs from run to run.
                reasons[reason.partition(":")[0]] += 1
            bar.advance(bar.task_ids[0])

        with taken_folder(folder):
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
