"""A compiled folder: written whole or not at all, and read again as the run of a session."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any, Literal

from ssp_core.errors import InputError
from ssp_core.files.folders import make_folder, put_in_place, scratch_beside
from ssp_core.files.writing import write_bytes, write_json, write_text
from ssp_core.run_file.model import RunSpec, load_run
from ssp_core.run_file.shortlist import SHORTLIST_FILE
from ssp_scenario_manager.compile.compiler import CompiledEvent
from ssp_scenario_manager.compile.targets.task_sheet import SHEET_FILE, write_sheet
from ssp_scenario_manager.compile.task import (
    EVENT_FILE,
    RUN_FILE,
    SITE_FILE,
    TASK_FILE,
    TASK_FOLDER,
    Target,
    Task,
    as_live,
    load_task,
)
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.log import LOG_FILE, read_log, record_line
from ssp_scenario_manager.maps.site import load_site


def _map_text(compiled: CompiledEvent) -> str | None:
    """Return the user's map, where it is OpenDRIVE."""
    data, area = compiled.area.map_data, compiled.area
    if data is None or area.link.kind != "opendrive":
        return None
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(
            f"is not UTF-8 (byte {error.start}), and this target takes the map's text over",
            file=area.map_name,
            remedy="convert the map to UTF-8",
        ) from error


def write_target(compiled: CompiledEvent, folder: Path) -> None:
    """Write the target's own files and the task sheet into a compiled folder.

    A track task is task.json; the sheet that every target has is its reading for people.

    Raises:
        InputError: the task has something that the target can't tell.
        HostError: this machine lacks what makes them.
    """
    # Each is imported where it is needed: their libraries take a second to load.
    task, real = compiled.task, compiled.realisation
    if task.target == "sumo":
        from ssp_scenario_manager.compile.targets.sumo import write_sumo

        write_sumo(task, folder)
    elif task.target == "openscenario":
        from ssp_scenario_manager.compile.targets.openscenario import export_openscenario

        export_openscenario(task, real.block, _map_text(compiled), folder)
    elif task.target == "carla":
        from ssp_scenario_manager.compile.targets.carla import export_carla

        export_carla(task, real.block, real.plan, _map_text(compiled), folder)
    write_sheet(compiled, folder)


_NAMES = frozenset(
    {
        TASK_FILE,
        EVENT_FILE,
        SITE_FILE,
        RUN_FILE,
        LOG_FILE,
        SHEET_FILE,
        SHORTLIST_FILE,
        "carla_config.json",
    }
)


def run_text(run: RunSpec) -> str:
    """Return a run file's text: JSON, which is YAML too."""
    return run.model_dump_json(by_alias=True, indent=1) + "\n"


def write_task_files(compiled: CompiledEvent, folder: Path) -> list[Path]:
    """Write the files of its task that a recording carries, into a folder that exists.

    Returns:
        task.json, event.yaml, site.yaml or the map, log.jsonl, and shortlist.json if there is one.
    """
    write_json(folder / TASK_FILE, json.loads(compiled.task.model_dump_json(by_alias=True)))
    write_bytes(folder / EVENT_FILE, compiled.event_file)
    area = compiled.area
    place = folder / (SITE_FILE if area.site is not None else area.map_name)
    write_bytes(place, compiled.site_file or area.map_data or b"")
    log = "".join(record_line(record) + "\n" for record in compiled.log)
    write_text(folder / LOG_FILE, log)
    files = [folder / TASK_FILE, folder / EVENT_FILE, place, folder / LOG_FILE]
    if compiled.shortlist is not None:
        write_bytes(folder / SHORTLIST_FILE, compiled.shortlist)
        files.append(folder / SHORTLIST_FILE)
    return files


def write_folder(compiled: CompiledEvent, out: Path, *, replace: bool = False) -> list[Path]:
    """Write a compiled folder with its target's own files.

    Args:
        compiled: the task and its place.
        out: the folder; its parents are made.
        replace: an earlier compiled folder there is replaced.

    Returns:
        All files, sorted.

    Raises:
        InputError: the folder holds something, and isn't to be replaced or isn't a task.
        HostError: the system doesn't let it be put there.
    """
    check_out(out, replace=replace)
    if compiled.area.map_name in _NAMES:
        raise InputError(
            "is the name of a file that is written beside it",
            file=compiled.area.map_name,
            remedy="rename the map",
        )
    work = scratch_beside(out)
    try:
        work.chmod(0o755)
        write_task_files(compiled, work)
        write_text(work / RUN_FILE, run_text(compiled.task.run))
        write_target(compiled, work)
        check_out(out, replace=replace)  # of another command that began at once
        put_in_place(work, out)
    except BaseException:
        shutil.rmtree(work, ignore_errors=True)
        raise
    return sorted(path for path in out.rglob("*") if path.is_file())


def check_out(out: Path, *, replace: bool) -> None:
    """Refuse, with an InputError, a folder that can't be written to without losing something."""
    if not os.path.lexists(out):
        return
    if not out.is_dir():
        raise InputError("is no folder", file=out, remedy="name another with --out")
    # The system doesn't let these be replaced by the finished folder.
    real = out.resolve()
    if real == Path.cwd() or real.is_mount():
        what = "the folder here" if real == Path.cwd() else "a mount"
        raise InputError(f"is {what}", file=out, remedy="name a new folder within it with --out")
    names = sorted(entry.name for entry in out.iterdir())
    if not names:
        return
    if not replace:
        raise InputError(
            "is not empty", file=out, remedy="name a new folder with --out, or give --force"
        )
    foreign = [name for name in names if not _ours(name)]
    if TASK_FILE not in names or RUN_FILE not in names or foreign:
        raise InputError(
            "holds something that no compilation made",
            file=out,
            value=", ".join(foreign or names),
            remedy="name another folder with --out",
        )
    if any(record.kind == "site_change" for record in read_log(out / LOG_FILE)):
        raise InputError(
            "records changes on site, which would be lost",
            file=out / LOG_FILE,
            remedy="name another folder with --out",
        )


def _ours(name: str) -> bool:
    """Tell whether a compilation may have made a file; maps and scenarios go by their endings."""
    return name in _NAMES or name.endswith((".xosc", ".xodr", ".xml", ".sumocfg"))


Mode = Literal["lockstep", "realtime", "live"]


def is_compiled(what: str) -> bool:
    """Tell whether `ssp compile` wrote this folder."""
    return (Path(what) / TASK_FILE).is_file()


def is_session(what: str) -> bool:
    """Tell whether `ssp run` filled this folder: it holds the task and the run as executed."""
    return is_compiled(str(Path(what) / TASK_FOLDER)) and (Path(what) / RUN_FILE).is_file()


def mode_of(what: str) -> Mode:
    """Return the mode that a run has by default: a session's own, or lockstep.

    Raises:
        InputError: the session's run file is not valid.
    """
    return load_run(Path(what) / RUN_FILE).mode if is_session(what) else "lockstep"


def check_event(what: str) -> None:
    """Check that there is a K*, or a folder with a task, of this name.

    Raises:
        InputError: there is none, or its K* is not valid.
    """
    if os.path.isdir(what):
        _has_task(what)
    else:
        load_event(what)


def _has_task(what: str) -> None:
    """Refuse a folder that `ssp compile` and `ssp run` didn't write."""
    if not (is_compiled(what) or is_session(what)):
        raise InputError(
            "is no compiled folder and no session's",
            file=what,
            remedy=f"it has neither {TASK_FILE} nor {TASK_FOLDER}/{TASK_FILE} with {RUN_FILE}; "
            "name a folder of `ssp compile` or `ssp run`, or an event",
        )


def prepare_run(
    what: str,
    site: str | None,
    folder: Path,
    *,
    seed: int | None,
    mode: Mode,
) -> RunSpec:
    """Compile an event into ``folder/task``, or take a compiled task over into it.

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
    if os.path.isdir(what):
        _has_task(what)
    if is_compiled(what):
        run = _take_over(Path(what), Path(what) / RUN_FILE, folder)
    elif is_session(what):
        run = _take_over(Path(what) / TASK_FOLDER, Path(what) / RUN_FILE, folder)
    else:
        run = _compile(what, site, folder, 1 if seed is None else seed)
    # Another session than the one that the file may be of.
    changes: dict[str, Any] = {"run_id": folder.name, "session_token": "", "declaring": ()}
    if seed is not None:
        changes["seed"] = seed
    run = run.model_copy(update=changes)
    return as_live(run) if mode == "live" else run.model_copy(update={"mode": mode})


def _compile(what: str, site: str | None, folder: Path, seed: int) -> RunSpec:
    from ssp_scenario_manager.compile.compiler import Request, compile_task

    if site is None:
        raise InputError("needs a site", field="site", remedy="give --site SITE")
    target: Target = "track" if load_site(site)[0].domain == "physical" else "sumo"
    compiled = compile_task(Request(event=what, target=target, site=site, seed=seed))
    write_task_files(compiled, make_folder(folder / TASK_FOLDER))
    return compiled.task.run


def _take_over(source: Path, run_file: Path, folder: Path) -> RunSpec:
    """Copy what a recording carries of a task, and read the run that was made of it."""
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
    """Check that the files of the folder belong together.

    Raises:
        InputError: it doesn't.
    """
    event_version = load_event(str(source / EVENT_FILE))[1]
    links = [
        (source / EVENT_FILE, "content", event_version, task.event.version),
        (run_file, "task_version", run.task_version, task.version),
        (run_file, "event_version", run.event_version, task.event.version),
    ]
    if task.place.kind == "site":
        site = load_site(str(source / SITE_FILE))[1]
        links.append((source / SITE_FILE, "content", site, task.place.sha256))
    for file, field, value, required_value in links:
        if value != required_value:
            raise InputError(
                "is not what the task was compiled from",
                file=file,
                field=field,
                value=value,
                remedy=f"{required_value} is needed; compile the event again",
            )
