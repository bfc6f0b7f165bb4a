"""``ssp run``: one session, recorded into a bag."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Literal, cast

import click

from ssp_core import console
from ssp_core.errors import InputError
from ssp_scenario_manager.resolve import resolve_run
from ssp_scenario_manager.scenario import load_scenario, load_site


@click.command()
@click.argument("scenario")
@click.option("--site", default="boulevard", show_default=True, help="Site, by name or file.")
@click.option("--seed", default=1, show_default=True, type=click.IntRange(0, 2**31))
@click.option(
    "--mode",
    type=click.Choice(["lockstep", "realtime"]),
    default="lockstep",
    show_default=True,
    help="lockstep: as fast as the machine allows and repeatable; realtime: by the wall clock.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="New folder for run.yaml, bag, logs and result.json. [default: out/run-SCENARIO-SITE-…]",
)
@click.option("--no-camera", is_flag=True, help="Render nothing.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def run(
    scenario: str,
    site: str,
    seed: int,
    mode: str,
    out: Path | None,
    no_camera: bool,
    as_json: bool,
) -> int:
    """Run one session of SCENARIO (a name or a file) and record it into a bag.

    The nodes run as processes of their own in a ROS domain of their own, on loopback. Exit status
    0 only when the run's verdict is valid.
    """
    plan, event_version = load_scenario(scenario)
    place, site_version = load_site(site)
    folder = out or Path("out") / time.strftime(f"run-{plan.name}-{place.name}-%Y%m%d-%H%M%S")
    if folder.is_dir() and any(folder.iterdir()):
        raise InputError("is not empty", file=folder, remedy="name a new folder with --out")
    spec = resolve_run(
        plan,
        event_version,
        place,
        site_version,
        run_id=folder.name,
        seed=seed,
        mode=cast(Literal["lockstep", "realtime"], mode),
    )
    if no_camera:
        spec = spec.model_copy(update={"camera": None})
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"can't be made: {error.strerror}", file=folder, remedy="name another folder"
        ) from error
    if place.stand_in:
        console.note(f"{place.name} is a software stand-in for a physical site, not a vehicle")
    from ssp_scenario_manager.runner.session import run_session

    result = run_session(spec, folder.resolve(), console.note)
    if as_json:
        click.echo(json.dumps(json.loads((folder / "result.json").read_text())))
    else:
        verdict = result.outcome.verdict.name.lower()
        console.out.print(
            f"{plan.name} on {place.name}: {verdict}, {result.session_s:.1f} s of session in "
            f"{result.wall_s:.1f} s, {folder / 'bag'}",
            markup=False,
        )
        for reason in result.outcome.reasons:
            console.out.print(f"  because {reason}", markup=False)
    return 0 if result.outcome.ok else 1
