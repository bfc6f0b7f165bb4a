"""A compiled folder: written whole or not at all, and the same bytes for the same input."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from pathlib import Path

from ssp_core.errors import InputError
from ssp_core.files import make_folder, write_bytes, write_json, write_text
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.shortlist import SHORTLIST_FILE
from ssp_scenario_manager.compile.compiler import Compiled
from ssp_scenario_manager.compile.outputs import write_target
from ssp_scenario_manager.compile.sheet import SHEET_FILE
from ssp_scenario_manager.compile.task import EVENT_FILE, RUN_FILE, SITE_FILE, TASK_FILE
from ssp_scenario_manager.spec.log import LOG_FILE
from ssp_scenario_manager.spec.log_file import read_log, record_line

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
    """A run file's text: JSON, which is YAML too."""
    return run.model_dump_json(by_alias=True, indent=1) + "\n"


def write_task_files(compiled: Compiled, folder: Path) -> list[Path]:
    """What a recording carries of its task, into a folder that is there.

    Returns:
        task.json, event.yaml, site.yaml or the map, log.jsonl, and shortlist.json if there is one.
    """
    write_json(folder / TASK_FILE, json.loads(compiled.task.model_dump_json(by_alias=True)))
    write_bytes(folder / EVENT_FILE, compiled.event_file)
    ground = compiled.ground
    place = folder / (SITE_FILE if ground.site is not None else ground.map_name)
    write_bytes(place, compiled.site_file or ground.map_data or b"")
    log = "".join(record_line(record) + "\n" for record in compiled.log)
    write_text(folder / LOG_FILE, log)
    files = [folder / TASK_FILE, folder / EVENT_FILE, place, folder / LOG_FILE]
    if compiled.shortlist is not None:
        write_bytes(folder / SHORTLIST_FILE, compiled.shortlist)
        files.append(folder / SHORTLIST_FILE)
    return files


def write_folder(compiled: Compiled, out: Path, *, replace: bool = False) -> list[Path]:
    """Writes a compiled folder with its target's own files.

    Args:
        compiled: what to write.
        out: new or empty folder.
        replace: an earlier compiled folder there is replaced.

    Returns:
        All files, sorted.

    Raises:
        InputError: the folder holds something, and isn't to be replaced or was made by nobody here.
    """
    check_out(out, replace=replace)
    if compiled.ground.map_name in _NAMES:
        raise InputError(
            "is the name of a file that is written beside it",
            file=compiled.ground.map_name,
            remedy="rename the map",
        )
    make_folder(out.absolute().parent)
    try:
        work = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.absolute().parent))
    except OSError as error:
        raise InputError(
            f"can't be made: {error.strerror}", file=out, remedy="name another folder with --out"
        ) from error
    try:
        work.chmod(0o755)
        write_task_files(compiled, work)
        write_text(work / RUN_FILE, run_text(compiled.task.run))
        write_target(compiled, work)
        _put_in_place(work, out)
    except BaseException:
        shutil.rmtree(work, ignore_errors=True)
        raise
    return sorted(path for path in out.rglob("*") if path.is_file())


def check_out(out: Path, *, replace: bool) -> None:
    """Raises InputError where a folder can't be written to without losing something."""
    if not os.path.lexists(out):
        return
    if not out.is_dir():
        raise InputError("is no folder", file=out, remedy="name another with --out")
    held = sorted(entry.name for entry in out.iterdir())
    if not held:
        return
    if not replace:
        raise InputError(
            "is not empty", file=out, remedy="name a new folder with --out, or give --force"
        )
    foreign = [name for name in held if not _ours(name)]
    if TASK_FILE not in held or RUN_FILE not in held or foreign:
        raise InputError(
            "holds something that no compilation made",
            file=out,
            value=", ".join(foreign or held),
            remedy="name another folder with --out",
        )
    if any(record.kind == "site_change" for record in read_log(out / LOG_FILE)):
        raise InputError(
            "tells of changes on site, which would be lost",
            file=out / LOG_FILE,
            remedy="name another folder with --out",
        )


def _ours(name: str) -> bool:
    """A file that a compilation may have made; maps and scenarios by their endings."""
    return name in _NAMES or name.endswith((".xosc", ".xodr", ".xml", ".sumocfg"))


def _put_in_place(work: Path, out: Path) -> None:
    """Renames the finished folder; an earlier one is gone only when the new one stands."""
    if not out.is_dir():
        work.rename(out)
        return
    old = Path(tempfile.mkdtemp(prefix=f".{out.name}.old.", dir=out.absolute().parent))
    out.rename(old / out.name)
    try:
        work.rename(out)
    except BaseException:
        (old / out.name).rename(out)
        raise
    finally:
        shutil.rmtree(old, ignore_errors=True)
