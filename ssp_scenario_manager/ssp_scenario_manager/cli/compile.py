"""``ssp compile``: an event for a simulator or a track (METHOD 2)."""

from __future__ import annotations

import getpass
import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import cast

import click
from rich.progress import Progress

from ssp_core import console
from ssp_core.options import WholeNumber
from ssp_scenario_manager.compile.choose import NoBlockChosen
from ssp_scenario_manager.compile.compiler import (
    CompiledEvent,
    EventRefused,
    Request,
    WrongOptions,
    check_options,
    compile_task,
)
from ssp_scenario_manager.compile.targets.folder import check_out, write_folder
from ssp_scenario_manager.compile.task import BlockScore, Target
from ssp_scenario_manager.maps.xml_input import Loading, untold

# Rows of the table of scores for people; --json has them all.
_MOST_ROWS = 25
# A block with a longer name, as a route over a ring, has a line for it.
_MOST_NAME = 100


def _login_name() -> str | None:
    """Return the name of the user who is logged in, None for a container's bare user id."""
    try:
        return getpass.getuser()
    except (OSError, KeyError):
        return None


@click.command("compile")
@click.argument("what")
@click.option(
    "--target",
    type=click.Choice(["sumo", "openscenario", "carla", "track"]),
    required=True,
    help="What to compile for.",
)
@click.option("--site", help="Site, by name or file.")
@click.option(
    "--map",
    "map_path",
    type=click.Path(path_type=Path),
    help="OpenDRIVE (.xodr) or SUMO (.net.xml) map; not for a track.",
)
@click.option(
    "--choose",
    metavar="BLOCK",
    help="Block to take where several score alike; recorded in the log.",
)
@click.option("--seed", default=1, show_default=True, type=WholeNumber(0, 2**31 - 1))
@click.option("--who", metavar="NAME", help="Who chooses, for the log. [default: login name]")
@click.option(
    "--validated-by",
    metavar="SIM_RUN",
    type=click.Path(path_type=Path),
    help="Folder of the simulation run whose anchors the track task takes over.",
)
@click.option(
    "--shortlist",
    metavar="FILE.json",
    type=click.Path(path_type=Path),
    help="List of `ssp shortlist` on which the event must be a candidate; for a track.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="New folder. [default: out/compiled/EVENT-TARGET-PLACE]",
)
@click.option("--force", is_flag=True, help="Replace an earlier compiled folder.")
@click.option("--json", "as_json", is_flag=True, help="Print scores and result as JSON.")
def compile_event(
    what: str,
    target: str,
    site: str | None,
    map_path: Path | None,
    choose: str | None,
    seed: int,
    who: str | None,
    validated_by: Path | None,
    shortlist: Path | None,
    out: Path | None,
    force: bool,
    as_json: bool,
) -> int:
    """Compile WHAT, an event by name or K* file, for a place.

    Every block of the place is scored against the event; the best that also passes connectivity
    and conflict-geometry checks is taken. The folder then holds task.json (sealed), event.yaml,
    the site or map, run.yaml, log.jsonl, task.html and the target's own files. `ssp run FOLDER`
    runs it.
    """
    request = Request(
        event=what,
        target=cast(Target, target),
        site=site,
        map_path=map_path,
        seed=seed,
        choose=choose,
        who=who or (_login_name() if choose is not None else None),
        validated_by=validated_by,
        shortlist=shortlist,
    )
    try:
        check_options(request)
    except WrongOptions as error:
        raise click.UsageError(str(error)) from error
    if out is not None:
        check_out(out, replace=force)
    try:
        with console.progress("compile", None) as bar:
            tell = partial(bar.update, bar.task_ids[0], advance=1)
            loading = untold if map_path is None else _roads_of(map_path, bar)
            compiled = compile_task(
                request, lambda block: tell(description=f"trying {block}"), loading
            )
    except (NoBlockChosen, EventRefused) as error:
        _print_findings(error, as_json)
        raise
    folder = out or _default_folder(compiled)
    files = write_folder(compiled, folder, replace=force)
    _print_report(compiled, folder, files, as_json)
    return 0


def _roads_of(map_path: Path, bar: Progress) -> Loading:
    """Show a line below the bar with the number of a map's roads that were read, and of all."""
    task = bar.add_task(f"roads of {map_path.name}", total=None)
    return lambda read, total: bar.update(task, completed=read, total=total)


def _default_folder(compiled: CompiledEvent) -> Path:
    task = compiled.task
    place = compiled.area.name.split(".")[0]
    return Path("out") / "compiled" / f"{task.event.name}-{task.target}-{place}"


def _print_findings(error: NoBlockChosen | EventRefused, as_json: bool) -> None:
    """Print what was found before the refusal; the message itself comes from the command line."""
    if isinstance(error, NoBlockChosen):
        if as_json:
            scores = [score.model_dump(mode="json") for score in error.scores]
            click.echo(json.dumps({"scores": scores, "tied": error.tied, "error": str(error)}))
        else:
            _print_scores(error.scores, None)
    elif as_json:
        failures = [failure.as_dict() for failure in error.failures]
        click.echo(json.dumps({"failures": failures, "error": str(error)}))


def _print_report(
    compiled: CompiledEvent, folder: Path, files: Sequence[Path], as_json: bool
) -> None:
    task = compiled.task
    unvalidated = task.target == "track" and task.validated_by is None
    if as_json:
        click.echo(
            json.dumps(
                {
                    "folder": str(folder),
                    "files": [str(path.relative_to(folder)) for path in files],
                    "event": task.event.name,
                    "event_version": task.event.version,
                    "task_version": task.version,
                    "block": task.block.id,
                    "chosen_by": task.chosen_by,
                    "validated_by": task.validated_by and task.validated_by.run_id,
                    "scores": [score.model_dump(mode="json") for score in task.retrieval],
                    "tunings": [tuning.model_dump(mode="json") for tuning in task.tunings],
                }
            )
        )
    else:
        _print_scores(task.retrieval, task.block.id)
        console.out.print(
            f"{task.event.name} for {task.target} on {task.place.name}, block {task.block.id} "
            f"({task.chosen_by}): {folder}",
            markup=False,
        )
    for name, why in compiled.area.library.faults[:_MOST_ROWS]:
        console.note(f"{name} of {compiled.area.name} is left out: {why}")
    for text in compiled.realisation.block.notes:
        console.note(f"block {task.block.id}: {text}")
    for text in compiled.realisation.left_out:
        console.note(f"left out of the surroundings: {text}")
    if unvalidated:
        console.note("these anchors are not validated: name the simulation run with --validated-by")


def _print_scores(scores: Sequence[BlockScore], winner: str | None) -> None:
    top_scores = scores[:_MOST_ROWS]
    names = (len(score.block) for score in top_scores)
    wide = max((length for length in names if length <= _MOST_NAME), default=5)
    console.out.print(f"{'block':{wide}}      T      I      C  total", markup=False)
    for score in top_scores:
        numbers = (score.topology, score.interaction, score.constraints, score.total)
        remark = "; ".join(score.reasons)
        if score.block == winner:
            remark = f"chosen; {remark}" if remark else "chosen"
        elif not score.eligible:
            remark = f"rejected: {remark}"
        name = f"{score.block:{wide}}"
        if len(name) > wide:
            console.out.print(name, markup=False, soft_wrap=True)
            name = " " * wide
        row = f"{name}  " + "  ".join(f"{value:.3f}" for value in numbers)
        console.out.print(f"{row}  {remark}".rstrip(), markup=False)
    if len(scores) > _MOST_ROWS:
        console.out.print(
            f"and {len(scores) - _MOST_ROWS} more blocks (--json has all)", markup=False
        )
