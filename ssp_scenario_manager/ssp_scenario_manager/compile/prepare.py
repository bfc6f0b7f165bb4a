"""From a name, a compiled folder or a session's folder to the run that a session starts with."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Literal

from ssp_core.errors import InputError
from ssp_core.files import make_folder
from ssp_core.run_file.model import RunSpec, load_run
from ssp_scenario_manager.compile.live import as_live
from ssp_scenario_manager.compile.task import (
    EVENT_FILE,
    RUN_FILE,
    SITE_FILE,
    TASK_FILE,
    Target,
    Task,
    load_task,
)
from ssp_scenario_manager.site import load_site
from ssp_scenario_manager.spec.load import load_event
from ssp_scenario_manager.spec.log import LOG_FILE

TASK_FOLDER = "task"
Mode = Literal["lockstep", "realtime", "live"]


def is_compiled(what: str) -> bool:
    """True for a folder that `ssp compile` wrote."""
    return (Path(what) / TASK_FILE).is_file()


def is_session(what: str) -> bool:
    """True for a folder that `ssp run` filled: it holds the task and the run as it was executed."""
    return is_compiled(str(Path(what) / TASK_FOLDER)) and (Path(what) / RUN_FILE).is_file()


def mode_of(what: str) -> Mode:
    """The mode that a run has where nobody names one: a session's own, or lockstep.

    Raises:
        InputError: the session's run file is not valid.
    """
    return load_run(Path(what) / RUN_FILE).mode if is_session(what) else "lockstep"


def prepare_run(
    what: str,
    site: str | None,
    folder: Path,
    *,
    seed: int | None,
    mode: Mode,
) -> RunSpec:
    """Compiles an event into ``folder/task``, or takes a compiled task over into it.

    Args:
        what: name or file of a K*, or a folder that `ssp compile` or `ssp run` wrote.
        site: name or file of a site; not looked at with a folder, which has its own.
        folder: of the run; its name becomes the run's id.
        seed: of the run; None: the compiled task's, or 1.
        mode: of the run.

    Returns:
        The run as it will be executed: with a folder that of its ``run.yaml``, changes on site and
        faults included; a live one as ``compile.live.as_live`` has it.

    Raises:
        InputError: the event or the site is not valid, or they don't fit.
    """
    if is_compiled(what):
        run = _take_over(Path(what), Path(what) / RUN_FILE, folder)
    elif is_session(what):
        run = _take_over(Path(what) / TASK_FOLDER, Path(what) / RUN_FILE, folder)
    elif Path(what).is_dir():
        raise InputError(
            "is no compiled folder and no session's",
            file=what,
            remedy=f"it has neither {TASK_FILE} nor {TASK_FOLDER}/{TASK_FILE} with {RUN_FILE}; "
            "name a folder of `ssp compile` or `ssp run`, or an event",
        )
    else:
        run = _compile(what, site, folder, 1 if seed is None else seed)
    changes = {"run_id": folder.name} if seed is None else {"run_id": folder.name, "seed": seed}
    run = run.model_copy(update=changes)
    return as_live(run) if mode == "live" else run.model_copy(update={"mode": mode})


def _compile(what: str, site: str | None, folder: Path, seed: int) -> RunSpec:
    from ssp_scenario_manager.compile.compiler import Request, compile_task
    from ssp_scenario_manager.compile.writer import write_task_files

    if site is None:
        raise InputError("needs a site", field="site", remedy="give --site SITE")
    target: Target = "track" if load_site(site)[0].domain == "physical" else "sumo"
    compiled = compile_task(Request(event=what, target=target, site=site, seed=seed))
    write_task_files(compiled, make_folder(folder / TASK_FOLDER))
    return compiled.task.run


def _take_over(source: Path, run_file: Path, folder: Path) -> RunSpec:
    """Copies what a recording carries of a task, and reads the run that was made of it."""
    task = load_task(source)
    run = load_run(run_file)
    _check_folder(source, run_file, task, run)
    place = SITE_FILE if task.place.kind == "site" else task.place.name
    names = [TASK_FILE, EVENT_FILE, place]
    if (source / LOG_FILE).is_file():
        names.append(LOG_FILE)
    missing = [name for name in names if not (source / name).is_file()]
    if missing:
        raise InputError("isn't there", file=source / missing[0], remedy="compile the event again")
    target = make_folder(folder / TASK_FOLDER)
    for name in names:
        shutil.copyfile(source / name, target / name)
    return run


def _check_folder(source: Path, run_file: Path, task: Task, run: RunSpec) -> None:
    """What lies in the folder belongs together.

    Raises:
        InputError: it doesn't.
    """
    found = load_event(str(source / EVENT_FILE))[1]
    links = [
        (source / EVENT_FILE, "content", found, task.event.version),
        (run_file, "task_version", run.task_version, task.version),
        (run_file, "event_version", run.event_version, task.event.version),
    ]
    if task.place.kind == "site":
        site = load_site(str(source / SITE_FILE))[1]
        links.append((source / SITE_FILE, "content", site, task.place.sha256))
    for file, field, value, wanted in links:
        if value != wanted:
            raise InputError(
                "is not what the task was compiled from",
                file=file,
                field=field,
                value=value,
                remedy=f"{wanted} is needed; compile the event again",
            )
