"""The driver of ``ssp run``: parsed, created once, and refused where it may not drive."""

from __future__ import annotations

from pathlib import Path

import click

from ssp_core import console
from ssp_core.errors import InputError
from ssp_core.host.locks import beside_measuring, measuring_alone
from ssp_core.run_file.model import RunSpec
from ssp_core.world.driver import sees_frames, try_driver
from ssp_scenario_manager.closed_loop.single_run.single import Drive, parse_drive
from ssp_scenario_manager.compile.targets.folder import Mode
from ssp_scenario_manager.run import faults


def asked_driver(
    text: str | None,
    latency: str | None,
    models_file: Path | None,
    mode: Mode,
    *,
    swept: bool,
    insecure: bool,
) -> Drive | None:
    """Return the driver that is asked for, made once; refuse one where it may not drive.

    Where its latency is measured, the command has its host for itself from here on: models that are
    loaded, and starts, would disturb what another one measures. Others wait for one that measures.
    """
    if text is None:
        if latency is not None:
            raise click.UsageError("--latency is that of a driver: it needs --drive")
        if models_file is not None:
            raise click.UsageError("--models holds drivers: it needs --drive")
        if insecure:
            raise click.UsageError("--drive-insecure is of a driver's connection: it needs --drive")
        return None
    if mode != "lockstep":
        raise click.UsageError(
            f"--drive goes with no {mode} session: no model drives hardware, and a driver's "
            "latency counts in simulated time"
        )
    if swept:
        raise click.UsageError("--drive goes with one run")
    drive = parse_drive(text, latency or "zero", models_file, insecure=insecure)
    measures = drive.latency.measured and sees_frames(drive.driver)
    alone = measuring_alone if measures else beside_measuring
    click.get_current_context().with_resource(alone(console.note))
    try_driver(drive.driver, drive.options)
    return drive


def check_driven(spec: RunSpec, what: str, seed: int | None, *, swept: bool) -> None:
    """Refuse a driven session's folder for many runs, or with another start."""
    driven = spec.driven
    if driven is not None and seed is not None:
        raise InputError(
            "is settled: the folder has its start, which another seed would make another one",
            field="--seed",
            value=seed,
            remedy="leave it out, or name the event instead of the folder",
        )
    if driven is not None and swept:
        raise InputError(
            "its VUT is led by a driver, in one run",
            file=what,
            field="driven",
            value=driven.driver,
            remedy="leave out --runs and --vary; `ssp loop` drives many",
        )


def await_measured(spec: RunSpec, drive: Drive | None) -> None:
    """Wait for a command that measures, before a driven run repeats kept answers.

    One that asks a driver did so before (``asked_driver``).
    """
    if spec.driven is not None and drive is None:
        click.get_current_context().with_resource(beside_measuring(console.note))


def check_twin(spec: RunSpec) -> None:
    """Refuse what the same run in one process, by which a driven session is judged, can't be."""
    if spec.driven is None:
        return
    wrong: list[tuple[str, str]] = [("mode", spec.mode)] if spec.mode != "lockstep" else []
    wrong += [("plant", spec.plant)] if spec.plant != "bodies" else []
    kinds = [(f"faults[{k}].kind", fault.kind) for k, fault in enumerate(spec.faults)]
    wrong += [(field, kind) for field, kind in kinds if kind in faults.NEED_PROCESSES]
    for field, value in wrong:
        raise InputError(
            "a session that a driver drives is simulated in lockstep, with our own bodies, and "
            "judged by the same run in one process",
            field=field,
            value=value,
            remedy="leave it out",
        )
