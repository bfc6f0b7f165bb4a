"""``--validated-by``: a simulation run whose anchors a track task takes over (METHOD 2)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ssp_core.bag.operations.check import check_bag
from ssp_core.bag.reading.reader import BagReader, bag_files
from ssp_core.errors import InputError
from ssp_core.files.reading import Model, parse_mapping, parse_model, read_mapping
from ssp_core.hashing import sha256_file, sha256_json
from ssp_core.names import PHASE_EVENT, SAFETY_EVENT, SESSION_STATE, absolute
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.verdict import RESULT_FILE, VERDICT_FILE
from ssp_core.vocabulary import Phase, Verdict
from ssp_scenario_manager.compile.changes import differences
from ssp_scenario_manager.compile.task import RUN_FILE, TASK_FILE, Task, Validation, check_seal

_VALID = Verdict.VALID.name.lower()
_REMEDY = "name the folder of a valid `ssp run` of this event's sumo task"


@dataclass(frozen=True)
class SimulationOutcome:
    """The outcome of a simulation run.

    Args:
        values: chosen there, by field path of K*.
    """

    validation: Validation
    values: dict[str, float]


def read_validation(folder: Path, event_version: str) -> SimulationOutcome:
    """Return the run in a folder, if it validates the anchors of an event.

    Its bag must be undamaged, every CRC of it. It must have been valid by the session's last word
    in the bag and by the runner's beside it, without a safety event, of the same K* version and of
    a sumo task with an unbroken seal, run as it was compiled, and have announced all four phases.

    Raises:
        InputError: one of these doesn't hold.
    """
    bag = folder / "bag"
    _check_verdict(folder / RESULT_FILE)
    _check_verdict(bag / VERDICT_FILE)
    damage = check_bag(bag).problems
    if damage:
        more = f" ({len(damage) - 1} more)" if len(damage) > 1 else ""
        raise InputError(f"is no sound recording: {damage[0]}{more}", file=bag, remedy=_REMEDY)
    with BagReader(bag) as reader:
        _check_recorded(reader)
        task = _attached(reader, TASK_FILE, Task)
        check_seal(task, f"{bag}:{TASK_FILE}")
        run = _attached(reader, RUN_FILE, RunSpec)
        phases = {int(reader.decode(m).phase) for m in reader.messages([absolute(PHASE_EVENT)])}
    _check(task, run, event_version, bag)
    missing = [
        phase.name.lower()
        for phase in (Phase.APPROACH, Phase.TRIGGER, Phase.CONFLICT, Phase.RESOLUTION)
        if phase not in phases
    ]
    if missing:
        raise InputError(
            f"never announced {', '.join(missing)}", file=bag, field="phase_event", remedy=_REMEDY
        )
    hashes = [sha256_file(file) for file in bag_files(bag)]
    digest = hashes[0] if len(hashes) == 1 else sha256_json(hashes)
    return SimulationOutcome(
        Validation(run_id=run.run_id, task_version=task.version, bag_sha256=digest),
        {tuning.field: tuning.value for tuning in task.tunings},
    )


def _check_verdict(file: Path) -> None:
    """Refuse a folder in which the runner's verdict isn't that of a valid run without reasons."""
    run_result = read_mapping(file)
    if run_result.get("verdict") != _VALID or run_result.get("reasons") != []:
        raise InputError(
            "is from a run that can't validate anything",
            file=file,
            field="verdict" if run_result.get("verdict") != _VALID else "reasons",
            value=run_result.get("verdict")
            if run_result.get("verdict") != _VALID
            else run_result.get("reasons"),
            remedy=_REMEDY,
        )


def _check_recorded(reader: BagReader) -> None:
    """Refuse a bag that tells of another verdict, or of a limit that was passed."""
    states = [reader.decode(m) for m in reader.messages([absolute(SESSION_STATE)])]
    verdict = int(states[-1].verdict) if states else int(Verdict.NONE)
    if verdict != Verdict.VALID:
        raise InputError(
            "is from a run that can't validate anything, by the last session state in it",
            file=reader.path,
            field=SESSION_STATE,
            value=Verdict(verdict).name.lower() if verdict in tuple(Verdict) else verdict,
            remedy=_REMEDY,
        )
    events = [reader.decode(m) for m in reader.messages([absolute(SAFETY_EVENT)])]
    if events:
        raise InputError(
            f"records {len(events)} safety event(s), first: {events[0].limit_name}",
            file=reader.path,
            field=SAFETY_EVENT,
            remedy=_REMEDY,
        )


def _attached(reader: BagReader, name: str, model: type[Model]) -> Model:
    data, place = reader.attachment(name), f"{reader.path}:{name}"
    if data is None:
        raise InputError("isn't in the bag", file=place, remedy=_REMEDY)
    return parse_model(model, parse_mapping(data, place), place)


def _check(task: Task, run: RunSpec, event_version: str, bag: Path) -> None:
    checks = (
        ("event.version", task.event.version, event_version, "is of another K* version"),
        ("target", task.target, "sumo", "is not of a simulation"),
        ("event_version", run.event_version, event_version, "is of another K* version"),
    )
    for field, value, required_value, problem in checks:
        if value != required_value:
            raise InputError(
                problem, file=bag, field=field, value=value, remedy=f"{required_value} is needed"
            )
    changed = differences(task.run, run)
    if changed:
        raise InputError(
            f"was run otherwise than compiled ({len(changed)} field(s), first: {changed[0].field})",
            file=bag,
            field=RUN_FILE,
            remedy="compile and run it again without changes",
        )
