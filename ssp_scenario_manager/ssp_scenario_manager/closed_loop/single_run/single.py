"""One driven run: the request, its start, and its entries in ``result.json``."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ssp_core.errors import InputError
from ssp_core.files.strict_json import parse_strict
from ssp_core.run_file.driven import BUILT_IN, Driven, is_driver_name
from ssp_core.run_file.latency import Latency, parse_latency
from ssp_core.run_file.model import RunSpec
from ssp_core.world.driver import (
    RecordedAnswer,
    driver_options,
    history_s_of,
    sees_frames,
)
from ssp_scenario_manager.closed_loop.answers import (
    ANSWERS_FILE,
    KeptAnswers,
    Question,
    load_answers,
    repeated,
    save_answers,
)
from ssp_scenario_manager.closed_loop.contact import Contact
from ssp_scenario_manager.closed_loop.outcomes.evaded import Twin
from ssp_scenario_manager.closed_loop.outcomes.needless import needless_of
from ssp_scenario_manager.closed_loop.outcomes.outcome import DriverRun, driven_summary, outcome_of
from ssp_scenario_manager.closed_loop.starts.start import (
    NoStart,
    Start,
    commanded,
    make_start,
    twin_of,
    without_event,
)
from ssp_scenario_manager.compile.task import NO_TUNINGS, TASK_FILE, Tuning, load_task
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.run.in_process import InProcessResult, Record, run_in_process

# Seeds that are tried for a start whose event is K*'s.
MOST_SEEDS = 50
# A policy that is given by its address alone, and the name that it drives under.
_POLICY_SCHEME, _POLICY = "grpc://", "egodriver"


@dataclass(frozen=True, slots=True)
class Drive:
    """A driver with its latency, as a person asks for it.

    Args:
        driver: its name.
        options: of it.
        latency: L.
    """

    driver: str
    options: Mapping[str, Any]
    latency: Latency


def named_driver(text: str, *, insecure: bool = False) -> tuple[str, dict[str, Any]]:
    """Return the name and the options of ``NAME``, ``NAME={…options}`` or ``grpc://HOST:PORT``.

    Args:
        text: as it was typed behind --drive.
        insecure: the driver's connection may be plain text to another host.

    Raises:
        InputError: it is no name, or the options are no JSON object.
    """
    name, _, options_text = text.partition("=")
    if text.startswith(_POLICY_SCHEME):
        name, options_text = _POLICY, json.dumps({"url": text})
    try:
        options: Any = parse_strict(options_text) if options_text.strip() else {}
    except ValueError as error:
        raise InputError(
            f"is not valid JSON: {error}",
            field=f"--drive {name}",
            remedy="""write --drive 'NAME={"option": value}'""",
        ) from None
    if not isinstance(options, dict):
        raise InputError(
            "must be a JSON object",
            field=f"--drive {name}",
            remedy="""write --drive 'NAME={"option": value}'""",
        )
    if not is_driver_name(name):
        raise InputError(
            "is no name for a topic",
            field="--drive",
            value=name,
            remedy="use letters, digits and underscores, a letter first, 64 at most",
        )
    if insecure:
        options = {**options, "insecure": True}
    return name, options


def parse_drive(
    text: str, latency: str, models_file: Path | None = None, *, insecure: bool = False
) -> Drive:
    """Read ``NAME``, ``NAME={…options}`` or ``grpc://HOST:PORT``, and a latency.

    The driver isn't made for it, see ``ssp_core.world.driver.try_driver``.

    Args:
        text: as it was typed.
        latency: likewise.
        models_file: of ssp.models/1, whose models may be named; None: none is given.
        insecure: the driver's connection may be plain text to another host.

    Raises:
        InputError: no such driver, option or latency.
    """
    name, options = named_driver(text, insecure=insecure)
    return Drive(name, driver_options(name, options, models_file), parse_latency(latency))


def driven_run(
    run: RunSpec, event_file: Path, drive: Drive | None, say: Callable[[str], None]
) -> RunSpec:
    """Return the run under a driver, on the start of the run's seed or of the next that is K*'s.

    A run that is driven already keeps its start. Without a driver it is returned as it is.

    Args:
        run: as it was compiled.
        event_file: its K*.
        drive: the driver; None: none is asked for.
        say: takes what becomes of seeds, for people.

    Raises:
        InputError: no seed gives a start, or the start leaves no time for the latency or for the
            driver's history, or its task can't be read or was changed.
    """
    if drive is None:
        return run
    if run.driven is not None:
        return _with_driver(run, drive, event_file.parent / TASK_FILE)
    history_s = history_s_of(drive.driver, drive.options)
    event = load_event(str(event_file))[0]
    tunings = load_task(event_file.parent).tunings_of(run)
    start = next_start(run, event, run.seed, drive.latency.seconds, say, history_s, tunings)
    return start.driven_by(drive.driver, drive.options, drive.latency)


def next_start(
    run: RunSpec,
    event: Event,
    seed: int,
    latency_max_s: float,
    say: Callable[[str], None],
    history_s: float = 0.0,
    tunings: Mapping[str, Tuning] = NO_TUNINGS,
) -> Start:
    """Return the start of the first seed from one on whose event is K*'s (METHOD 8.1).

    Args:
        run: as it was compiled.
        event: K*.
        seed: the first one.
        latency_max_s: largest latency.
        say: takes what becomes of seeds, for people.
        history_s: longest history of a driver.
        tunings: of the task that the run is of, by field of K*.

    Raises:
        InputError: none of MOST_SEEDS gives one.
    """
    why = ""
    for tried in range(seed, seed + MOST_SEEDS):
        try:
            return make_start(run, event, tried, latency_max_s, history_s, tunings)
        except NoStart as error:
            why = why or str(error)
            say(f"seed {tried} gives no start of {run.scenario}: {error}")
    raise InputError(
        f"no start from seed {seed} to {seed + MOST_SEEDS - 1}: {why}",
        field="seed",
        value=seed,
        remedy="give another seed, a smaller latency, or a place with a longer run-up",
    )


def _with_driver(run: RunSpec, drive: Drive, task_file: Path) -> RunSpec:
    driven = run.driven
    if driven is None:
        raise ValueError("the run has no driver of its VUT")
    room_s = driven.hand_over_s - driven.first_request_s - driven.frame_period_s
    latency = drive.latency
    if latency.seconds > room_s + 1e-9:
        raise InputError(
            f"is more than this start leaves time for, {max(room_s, 0.0):.3g} s",
            field="--latency",
            value=str(latency),
            remedy="name the event instead of the folder, for a start of its own",
        )
    history_s = history_s_of(drive.driver, drive.options)
    if history_s > driven.first_request_s + 1e-9:
        raise InputError(
            f"needs {history_s:g} s of own motion before its first question, which is about "
            f"{driven.first_request_s:g} s",
            field=f"--drive {drive.driver}",
            remedy="name the event instead of the folder, for a start of its own",
        )
    changes = {
        "driver": drive.driver,
        "options": dict(drive.options),
        "latency": latency,
    }
    camera = None
    if sees_frames(drive.driver):
        # The start has a camera even where its first driver saw nothing.
        camera = load_task(task_file).run.camera if run.camera is None else run.camera
    return run.model_copy(update={"driven": driven.model_copy(update=changes), "camera": camera})


def driven_run_summary(
    run: RunSpec,
    result: InProcessResult,
    record: Record,
    *,
    folder: Path | None = None,
    model_answers: KeptAnswers | None = None,
) -> tuple[dict[str, Any], Contact | None]:
    """Return what ``result.json`` says of who drove, and the contact of the outcome.

    Of a run without a driver nothing is said. The twins are driven again for it: but for a model's
    answers, nothing but the run file has to be kept.

    Args:
        run: as it was driven.
        result: of the run.
        record: of the run.
        folder: takes the answers of a model; None: they aren't kept.
        model_answers: answers of the run before, which the driver repeats; None: it is asked.
    """
    driven = run.driven
    if driven is None:
        return {}, None
    twin, contact = twin_of(run)
    outcome = outcome_of(run, driven, result, record, twin)
    v_r_mps = None if contact is None else contact.relative_mps
    summary = driven_summary(driven, record, outcome, v_r_mps)
    free, built_in = _without_event(run, driven, twin, repeated(model_answers, event=False))
    event = DriverRun(run, driven, result, record, outcome)
    needless = needless_of(event, free, built_in, contact)
    if folder is not None and repeats_answers(driven):
        answers = KeptAnswers(Question.of(driven), event.answers, free.answers)
        save_answers(folder / ANSWERS_FILE, answers)
    return {"driven": summary | {"needless": needless}}, outcome.contact


def load_repeated_answers(run: RunSpec, drive: Drive | None, folder: Path) -> KeptAnswers | None:
    """Return the answers with which a run of a folder is driven again.

    Args:
        run: of the folder.
        drive: another driver; None: there is none.
        folder: of the run.

    Returns:
        None where the driver is asked.

    Raises:
        InputError: they aren't there any more, or are of another run.
    """
    if drive is not None or run.driven is None or not repeats_answers(run.driven):
        return None
    remedy = "give --drive, and the model is asked again"
    return load_answers(folder / ANSWERS_FILE, remedy, run.driven)


def repeats_answers(driven: Driven) -> bool:
    """Tell whether a driven run is driven again with the answers that it had."""
    return sees_frames(driven.driver)


def _without_event(
    run: RunSpec, driven: Driven, twin: Twin, answers: Sequence[RecordedAnswer] | None
) -> tuple[DriverRun, Record]:
    """Drive the event-free twin of a run, under its driver and under the built-in one."""
    free = without_event(run, driven.end_s)
    own = driven.model_copy(update={"observable_s": None})
    result, record = run_in_process(free.model_copy(update={"driven": own}), answers=answers)
    outcome = outcome_of(free, own, result, record, twin)
    led = own.model_copy(update=commanded(BUILT_IN))
    _, built_in = run_in_process(free.model_copy(update={"driven": led, "camera": None}))
    return DriverRun(free, own, result, record, outcome), built_in
