"""The files that a target has of its own (METHOD 2.5)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ssp_core.errors import InputError
from ssp_scenario_manager.compile.compiler import Compiled
from ssp_scenario_manager.compile.sheet import write_sheet
from ssp_scenario_manager.compile.task import Target


def _sumo(compiled: Compiled, folder: Path) -> None:
    from ssp_scenario_manager.compile.sumo import write_sumo

    write_sumo(compiled.task, folder)


def _openscenario(compiled: Compiled, folder: Path) -> None:
    from ssp_scenario_manager.compile.export.openscenario import export_openscenario

    real = compiled.realisation
    export_openscenario(
        compiled.task, compiled.event, real.block, real.plan, _map_text(compiled), folder
    )


def _carla(compiled: Compiled, folder: Path) -> None:
    from ssp_scenario_manager.compile.export.carla import export_carla

    real = compiled.realisation
    export_carla(compiled.task, compiled.event, real.block, real.plan, _map_text(compiled), folder)


def _track(compiled: Compiled, folder: Path) -> None:
    """A track task is task.json; the sheet that every target has is its reading for people."""


def _map_text(compiled: Compiled) -> str | None:
    """The user's map, where it is OpenDRIVE."""
    data, ground = compiled.ground.map_data, compiled.ground
    if data is None or ground.link.kind != "opendrive":
        return None
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(
            f"is not UTF-8 (byte {error.start}), and this target takes the map's text over",
            file=ground.map_name,
            remedy="convert the map to UTF-8",
        ) from error


_WRITERS: dict[Target, Callable[[Compiled, Path], None]] = {
    "sumo": _sumo,
    "openscenario": _openscenario,
    "carla": _carla,
    "track": _track,
}


def write_target(compiled: Compiled, folder: Path) -> None:
    """Writes the target's own files and the task sheet into a compiled folder.

    Raises:
        InputError: the task has something that the target can't tell.
        HostError: this machine lacks what makes them.
    """
    _WRITERS[compiled.task.target](compiled, folder)
    write_sheet(compiled, folder)
