"""``ssp run``: one session, recorded into a bag."""

from __future__ import annotations

import json
import tempfile
import time
from collections import Counter
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ssp_core import console, names
from ssp_core.carla.acceptance import ServerOfRun
from ssp_core.carla.address import SCHEME, parse_address
from ssp_core.errors import InputError
from ssp_core.host.domains import folder_of_domains
from ssp_core.host.shared_memory import check_shared_memory
from ssp_core.options import WholeNumber
from ssp_core.run_file.faults import load_faults, with_faults
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import Verdict
from ssp_core.world.driver import sees_frames
from ssp_scenario_manager.cli.driving import (
    asked_driver,
    await_measured,
    check_driven,
    check_twin,
)
from ssp_scenario_manager.closed_loop.answers import ANSWERS_FILE, repeated
from ssp_scenario_manager.closed_loop.single_run.before import before_of_folder
from ssp_scenario_manager.closed_loop.single_run.sessions import session_summary
from ssp_scenario_manager.closed_loop.single_run.single import (
    driven_run,
    load_repeated_answers,
)
from ssp_scenario_manager.closed_loop.single_run.top_view import summary_with_view
from ssp_scenario_manager.compile.changes import differences, with_value
from ssp_scenario_manager.compile.targets.folder import (
    Mode,
    is_compiled,
    is_session,
    mode_of,
    prepare_run,
)
from ssp_scenario_manager.compile.task import (
    EVENT_FILE,
    TASK_FOLDER,
    check_live,
    load_task,
    run_folder,
)
from ssp_scenario_manager.run import faults
from ssp_scenario_manager.run.junit import Case, write_junit
from ssp_scenario_manager.run.over_dds.companions import DEFAULT_PORT, shadow_model
from ssp_scenario_manager.run.over_dds.live import LiveSetup, live_options
from ssp_scenario_manager.run.sweep import (
    for_one_process,
    is_sweep,
    run_many,
    run_one,
    say_driven,
    warn_of_late_conflict,
)
from ssp_scenario_manager.session.run_script import RunOutcome

if TYPE_CHECKING:
    from ssp_scenario_manager.run.over_dds.session import RunResult

DEFAULT_SITE = "boulevard"


@click.command()
@click.argument("what")
@click.option(
    "--site", help=f"Site, by name or file; not with a compiled folder. [default: {DEFAULT_SITE}]"
)
@click.option("--seed", type=WholeNumber(0, 2**31 - 1), help="[default: the compiled task's, or 1]")
@click.option(
    "--mode",
    type=click.Choice(["lockstep", "realtime", "live"]),
    help="lockstep: as fast as the machine allows and repeatable; realtime: by the wall clock; "
    "live: real objects and a real camera, in the ROS domain of the environment "
    "(docs/deployment.md). [default: lockstep, or that of a session's folder]",
)
@click.option(
    "--faults",
    "faults_file",
    type=click.Path(path_type=Path),
    help="File (ssp.faults/1) with faults to inject, and disturbances instead of the site's.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="New folder for everything the run writes; an interrupted sweep is resumed in its own. "
    "[default: out/run-…]",
)
@click.option("--no-camera", is_flag=True, help="Don't render camera frames.")
@click.option(
    "--camera",
    "camera_text",
    metavar="raster|carla://HOST[:PORT]",
    help="Renderer of the frames: our own, or a CARLA server with the map that the task was "
    "compiled for (docs/carla.md).  [default: that of the task, raster]",
)
@click.option(
    "--plant",
    "plant_text",
    metavar="bodies|carla://HOST[:PORT]",
    help="What moves VUT and object targets: our own bodies, or the vehicle physics of a CARLA "
    "server as above, by throttle, brake and steering. Such a run isn't repeatable byte for "
    "byte.  [default: that of the task, bodies]",
)
@click.option(
    "--in-process",
    is_flag=True,
    help="One process without ROS, many times faster than real time, with the same states; camera "
    "and bag with --record alone.",
)
@click.option(
    "--record",
    is_flag=True,
    help="With --in-process: draw the camera's frames too, unless --no-camera is given, and write "
    "the bag that the session's nodes would leave.",
)
@click.option(
    "--runs",
    type=WholeNumber(1, 1_000_000),
    help="With --in-process: number of runs, with consecutive seeds; one row each in runs.csv.",
)
@click.option(
    "--vary",
    multiple=True,
    metavar="FIELD=VALUES",
    help="With --in-process: values of a field of run.yaml: a:b (drawn at random for each run, "
    "uniformly from a to b, by the seed) or a,b,c (in turn); may be repeated.",
)
@click.option(
    "--jobs",
    type=WholeNumber(1, 1024),
    help="With --runs or --vary: processes that share the runs. [default: 1]",
)
@click.option(
    "--junit",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Also write the verdict as JUnit XML: failed, aborted and off-spec runs are failures, "
    "harness faults are errors.",
)
@click.option(
    "--video",
    type=click.Choice(["h264", "h265"]),
    help="Record the camera as video, at an eighth of the size. [default: its JPEG frames]",
)
@click.option(
    "--page",
    "page_port",
    type=WholeNumber(0, 65535),
    is_flag=False,
    flag_value=DEFAULT_PORT,
    metavar="[PORT]",
    help="Serve the operators' page beside the session, on loopback; 0: any free port. "
    f"[default port: {DEFAULT_PORT}]",
)
@click.option(
    "--shadow",
    "shadow_texts",
    multiple=True,
    metavar="NAME[=JSON]",
    help='Let a VLA bridge follow the session and record its answers; NAME or NAME={"backend": …, '
    '"hz": 2, …options}. It steers nothing; may be repeated.',
)
@click.option(
    "--drive",
    "drive_text",
    metavar="NAME[=JSON]",
    help="Let a driver drive the VUT by its plans (docs/closed-loop.md): a baseline, such as "
    'oracle or aeb={"ttc_s": 1.4}, or a model, named as with `ssp evaluate`: '
    'NAME={"backend": …, …options}, or NAME of the --models file; or grpc://HOST:PORT, a '
    "policy written for AlpaSim (docs/drivers.md).",
)
@click.option(
    "--drive-insecure",
    is_flag=True,
    help="With --drive grpc://…: plain text to a host that isn't loopback.",
)
@click.option(
    "--models",
    "models_file",
    type=click.Path(path_type=Path, dir_okay=False),
    help="With --drive: file (ssp.models/1) whose models it may name.",
)
@click.option(
    "--latency",
    metavar="zero|fixed:S|measured[:S]",
    help="With --drive: time from a frame until its answer takes effect; measured: the time from "
    "the complete request to the parsed trajectory, of which at most S counts before the "
    "hand-over (2 s). [default: zero]",
)
@live_options
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def run(
    what: str,
    site: str | None,
    seed: int | None,
    mode: Mode | None,
    faults_file: Path | None,
    out: Path | None,
    no_camera: bool,
    camera_text: str | None,
    plant_text: str | None,
    in_process: bool,
    record: bool,
    runs: int | None,
    vary: tuple[str, ...],
    jobs: int | None,
    junit: Path | None,
    video: str | None,
    page_port: int | None,
    shadow_texts: tuple[str, ...],
    drive_text: str | None,
    drive_insecure: bool,
    models_file: Path | None,
    latency: str | None,
    as_json: bool,
    **live_given: Any,
) -> int:
    """Run one session of WHAT and record it into a bag.

    WHAT is an event, by name or K* file, which is compiled for the site first, a folder that
    `ssp compile` wrote, or one that `ssp run` wrote: its session is run again, with the same task,
    seed, mode, faults and changes on site, into a new folder. The nodes run as processes of their
    own in a ROS domain of their own, on loopback; a live session leaves the simulated world and
    camera out and joins the domain of the environment. Exit status 0 only when the run's verdict is
    valid.

    \b
    For example:
      ssp run cut_in
      ssp run vru_crossing --site north_track --faults faults.yaml
      ssp run out/run-cut_in-boulevard-20250101-120000 --out again
      ssp run cut_in --in-process --runs 100 --vary driver.cruise_mps=11:15 --jobs 2
      ssp run out/task --mode live --body ot1=udp://10.0.0.21:9001 --odometry /ins/odom --wait
    """
    mode = mode or ("lockstep" if in_process else mode_of(what))
    drive = asked_driver(
        drive_text,
        latency,
        models_file,
        mode,
        swept=bool(runs or vary),
        insecure=drive_insecure,
    )
    live = LiveSetup.of_options(mode, live_given)
    shadows = [shadow_model(text) for text in shadow_texts]
    swept = runs is not None or bool(vary)
    _check_options(
        in_process=in_process,
        record=record,
        swept=swept,
        jobs=jobs,
        mode=mode,
        junit=junit,
        page_port=page_port,
        video=video,
        camera_text=camera_text,
        plant_text=plant_text,
        no_camera=no_camera,
        shadow_texts=shadow_texts,
    )
    compiled = is_compiled(what) or is_session(what)
    if compiled and site is not None:
        raise InputError(
            "is settled: the folder has its site",
            field="--site",
            value=site,
            remedy="leave it out, or name the event instead of the folder",
        )
    place = None if compiled else site or DEFAULT_SITE
    folder = out or Path("out") / _name(what, place)
    if folder.is_dir() and any(folder.iterdir()) and not (swept and is_sweep(folder)):
        raise InputError("is not empty", file=folder, remedy="name a new folder with --out")
    # Made beside it, so that what is refused leaves nothing behind.
    with tempfile.TemporaryDirectory(prefix="ssp-run-") as scratch:
        draft = Path(scratch) / (folder.resolve().name or "run")
        spec = prepare_run(
            what,
            place,
            draft,
            seed=seed,
            mode=mode,
        )
        if faults_file is not None:
            spec = with_faults(spec, load_faults(faults_file), faults_file)
        check_live(spec)
        check_driven(spec, what, seed, swept=swept)
        await_measured(spec, drive)
        if live is not None:
            live.check(spec)
        _tell(spec, draft, compiled)
        if swept:
            return run_many(spec, folder, vary, runs, jobs or 1, as_json)
        answers = load_repeated_answers(spec, drive, Path(what))
        repeats = spec.driven is not None and drive is None and faults_file is None
        before = before_of_folder(Path(what)) if repeats else None
        if repeats and before is None:
            console.note(f"{what} has no sound result, against which this run could be held")
        spec = driven_run(spec, draft / TASK_FOLDER / EVENT_FILE, drive, console.note)
        # A driver that sees has its frames drawn whether they are recorded or not.
        seeing = spec.driven is not None and sees_frames(spec.driven.driver)
        if no_camera or (in_process and not record and not seeing):
            spec = spec.model_copy(update={"camera": None})
        if seeing and (no_camera or camera_text not in (None, "raster")):
            raise click.UsageError(
                "a model drives by the frames of our own renderer; leave out --no-camera and "
                "--camera"
            )
        spec, servers = _with_carla(spec, camera_text, plant_text, draft / TASK_FOLDER, folder)
        if in_process:
            spec = for_one_process(spec, camera=record or seeing)
        else:
            check_twin(spec)
            faults.check(spec, _nodes(spec))
            check_shared_memory()
            if live is None:
                folder_of_domains()
        if junit is not None:
            # Whatever ends the runner before the run: a build server finds no older verdict here.
            write_junit(junit, "ssp run", [_case(spec, folder)])
        # Two commands into one folder would destroy each other's recording.
        click.get_current_context().with_resource(run_folder(folder, draft / TASK_FOLDER))
    if in_process:
        drawn_by = servers.get(names.FRONT_CAMERA)
        result_fields = run_one(
            spec,
            folder,
            as_json,
            recorded=record,
            server=drawn_by,
            further=partial(summary_with_view, folder, answers, before),
            answers=repeated(answers),
        )
        if junit is not None:
            write_junit(junit, "ssp run", [_case(spec, folder, result_fields)])
        return 0 if result_fields["verdict"] == "valid" else 1
    from ssp_scenario_manager.run.over_dds.session import run_session

    result = run_session(
        spec,
        folder.resolve(),
        console.note,
        live,
        page_port,
        video,
        shadows,
        servers,
        partial(session_summary, before, answers),
        None if answers is None else (Path(what) / ANSWERS_FILE).resolve(),
    )
    _say_session(spec, folder, result, as_json)
    if junit is not None:
        write_junit(junit, "ssp run", [_case(spec, folder, result.result_fields)])
    return 0 if result.outcome.ok and not result.unwritten else 1


def _say_session(spec: RunSpec, folder: Path, result: RunResult, as_json: bool) -> None:
    """Print how a session of several processes ended."""
    if as_json:
        click.echo(json.dumps(result.result_fields))
    else:
        verdict = result.outcome.verdict.name.lower()
        console.out.print(
            f"{spec.scenario} on {spec.site}: {verdict}, {result.session_s:.1f} s of session in "
            f"{result.wall_s:.1f} s, {folder / result.bag.name}",
            markup=False,
        )
        for reason in result.outcome.reasons:
            console.out.print(f"  because {reason}", markup=False)
        warn_of_late_conflict(result.result_fields)
        if "driven" in result.result_fields:
            say_driven(result.result_fields["driven"])
    for line in result.unwritten:
        console.report_error(line)


def _check_options(
    *,
    in_process: bool,
    record: bool,
    swept: bool,
    jobs: int | None,
    mode: Mode,
    junit: Path | None,
    page_port: int | None,
    video: str | None,
    camera_text: str | None,
    plant_text: str | None,
    no_camera: bool,
    shadow_texts: tuple[str, ...],
) -> None:
    """Refuse options that contradict each other."""
    if (swept or jobs is not None) and not in_process:
        raise click.UsageError("--runs, --vary and --jobs need --in-process")
    if record and (not in_process or swept):
        raise click.UsageError("--record goes with --in-process, and with one run")
    if swept and junit is not None:
        raise click.UsageError("--junit reports one run; --runs and --vary leave runs.csv")
    if jobs is not None and not swept:
        raise click.UsageError("--jobs needs --runs or --vary")
    if in_process and mode != "lockstep":
        raise click.UsageError("--in-process has no clock to follow: it is always lockstep")
    if in_process and page_port is not None:
        raise click.UsageError("--in-process has no ROS for a page to listen to; leave out --page")
    if in_process and video is not None:
        raise click.UsageError("--in-process has no camera to record; leave out --video")
    if camera_text is not None and (no_camera or mode == "live" or (in_process and not record)):
        raise click.UsageError(
            "--camera goes with a simulated session that has a camera; with --in-process that is "
            "one with --record"
        )
    if plant_text is not None and (mode == "live" or (in_process and plant_text != "bodies")):
        raise click.UsageError(
            "--plant moves the bodies of a simulated session alone, of one in processes of its own"
        )
    if shadow_texts and (in_process or (no_camera and mode != "live")):
        raise click.UsageError("--shadow needs a camera and processes to follow")
    for name, count in Counter(text.partition("=")[0] for text in shadow_texts).items():
        if count > 1:
            raise click.UsageError(f"--shadow {name} is given {count} times")


def _with_carla(
    spec: RunSpec, camera: str | None, plant: str | None, task: Path, folder: Path
) -> tuple[RunSpec, dict[str, ServerOfRun]]:
    """Return the run with what draws and moves it, and CARLA servers by the node that asks them.

    Args:
        spec: the run.
        camera: as typed; None: the run's own.
        plant: likewise.
        task: of the run.
        folder: into which the task is moved.

    Raises:
        InputError: there is none, or CARLA can't draw or move this run.
    """
    servers: dict[str, ServerOfRun] = {}
    before = None if spec.camera is None else spec.camera.renderer
    if _asks_carla("--camera", camera, "raster", before):
        if spec.camera is None:
            raise InputError(
                "the run has no camera",
                field="--camera",
                value=camera,
                remedy="leave --camera out, or compile the run with a camera",
            )
        servers[names.FRONT_CAMERA] = _server("--camera", camera, spec, task, folder)
    if spec.camera is not None:
        renderer = "carla" if names.FRONT_CAMERA in servers else "raster"
        if spec.camera.renderer != renderer:
            spec = with_value(spec, "camera.renderer", renderer)
    if _asks_carla("--plant", plant, "bodies", spec.plant):
        servers[names.SIL_WORLD] = _server("--plant", plant, spec, task, folder)
    if len(servers) > 1:
        raise InputError(
            "goes without --camera carla://…: one client ticks a server",
            field="--plant",
            value=plant,
            remedy="leave --camera out, and have the recording drawn by `ssp draw` afterwards",
        )
    moves = "carla" if names.SIL_WORLD in servers else "bodies"
    return spec.model_copy(update={"plant": moves}), servers


def _asks_carla(option: str, text: str | None, ours: str, before: str | None) -> bool:
    """Tell whether CARLA does what an option is about.

    Args:
        option: its name, for messages.
        text: as typed; None: as before.
        ours: the word for our own renderer or bodies.
        before: of the run.

    Raises:
        InputError: the text names nothing, or the run's server isn't named.
    """
    if (text or before or ours) == ours:
        return False
    if text is None or not text.startswith(SCHEME):
        raise InputError(
            f"names neither {ours} nor a server"
            if text
            else "is missing, and the run of this folder uses CARLA",
            field=option,
            value=text,
            remedy=f"give {ours}, or carla://HOST:PORT",
        )
    return True


def _server(option: str, text: str | None, spec: RunSpec, task: Path, folder: Path) -> ServerOfRun:
    """Return the CARLA server that an option names, and the map that it must have.

    Raises:
        InputError: no server can serve this run.
    """
    if spec.mode != "lockstep":
        raise InputError(
            "CARLA draws and moves in lockstep only: by the wall clock a late frame would be lost",
            field="--mode",
            value=spec.mode,
            remedy="leave --mode out",
        )
    address = parse_address(text or "", option)
    place = load_task(task).place
    if place.kind != "opendrive":
        raise InputError(
            f"the run is placed on a {place.kind}, {place.name}: no CARLA server has that map",
            field=option,
            value=text,
            remedy="compile the event for the server's map: ssp compile EVENT --target sumo --map "
            "TOWN.xodr --out T, then ssp run T",
        )
    map_file = (folder / TASK_FOLDER / place.name).resolve()
    return ServerOfRun(address, map_file)


def _nodes(spec: RunSpec) -> list[str]:
    """Return names of the processes that a session of this run has."""
    always = [names.MONITOR, names.SIL_WORLD, names.OBJECT_TARGET, names.SCENARIO_MANAGER]
    return always + ([names.FRONT_CAMERA] if spec.camera is not None else [])


def _case(spec: RunSpec, folder: Path, result_fields: dict[str, Any] | None = None) -> Case:
    """Return the run as result.json tells it, None before the end."""
    facts = {"seed": str(spec.seed), "mode": spec.mode, "folder": str(folder)}
    group = f"{spec.scenario}.{spec.site}"
    if result_fields is None:
        return Case(group, spec.run_id, RunOutcome(Verdict.NONE, ("did not end",)), 0.0, facts)
    outcome = RunOutcome(Verdict[result_fields["verdict"].upper()], tuple(result_fields["reasons"]))
    # A run in one process has no time but its own, so that its result is the same every time.
    took_s = result_fields.get("wall_s", result_fields["session_s"])
    return Case(group, spec.run_id, outcome, took_s, facts)


def _name(what: str, site: str | None) -> str:
    """Name the folder of a run that was given no name."""
    parts = [Path(what).name.split(".")[0]]
    if site is not None:
        parts.append(Path(site).name.split(".")[0])
    return time.strftime(f"run-{'-'.join(parts)}-%Y%m%d-%H%M%S")


def _tell(spec: RunSpec, folder: Path, compiled: bool) -> None:
    if spec.domain == "physical" and spec.mode != "live":
        console.note(f"{spec.site}: this session is a software stand-in, not a vehicle")
    if not compiled:
        return
    changes = [
        change
        for change in differences(load_task(folder / TASK_FOLDER).run, spec)
        if change.compiled is not None or change.executed is not None
    ]
    for change in changes:
        console.note(f"changed on site: {change.field} {change.compiled!r} → {change.executed!r}")
    if changes:
        console.note("changes on site must stand in log.jsonl (`ssp package log-change`)")
