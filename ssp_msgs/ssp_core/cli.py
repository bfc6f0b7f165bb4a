"""The command line ``ssp``: a table of verbs, each loaded only when it is asked for."""

from __future__ import annotations

import atexit
import gc
import importlib
import os
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from signal import Signals
from typing import Any, NoReturn

import click

from ssp_core import __version__
from ssp_core.cycles import search_as_usual
from ssp_core.errors import SYSTEM_REMEDIES, InputError, SspError
from ssp_core.host.environment import ONE_THREAD, set_log_folder, set_middleware_aside
from ssp_core.host.terminal import end_at_once, lost_output, on_stop_signals, survive_lost_output

# verb: (module:function, one line of help). A verb's module is imported when it runs or shows
# its own help, so that `ssp --help` and `ssp score` don't pay for SUMO, OpenCV or ROS.
VERBS: dict[str, tuple[str, str]] = {
    "demo": (
        "ssp_eval.demo:demo",
        "Run example events in three domains and report the scores.",
    ),
    "spec": (
        "ssp_scenario_manager.cli.spec:spec",
        "Check, draw, compare, extract and review event specifications.",
    ),
    "maps": (
        "ssp_scenario_manager.cli.maps:maps",
        "List junctions of a map or site, routes through them, and where they conflict.",
    ),
    "compile": (
        "ssp_scenario_manager.cli.compile:compile_event",
        "Compile an event for a simulator or a track.",
    ),
    "run": ("ssp_scenario_manager.cli.run:run", "Run one session and record it into a bag."),
    "loop": (
        "ssp_scenario_manager.cli.loop:loop",
        "Run a campaign in which drivers drive the VUT, and rate them.",
    ),
    "ablate": (
        "ssp_eval.ablation.cli:ablate",
        "Realise an event with and without its structure, and show what is lost.",
    ),
    "draw": (
        "ssp_eval.draw.cli:draw",
        "Draw the pictures of a finished recording anew with CARLA.",
    ),
    "driver": (
        "ssp_eval.evaluate.drivers_cli:driver",
        "Serve bridges for AlpaSim, and check policies that were written for it.",
    ),
    "import-bag": (
        "ssp_eval.importers.cli:import_bag_command",
        "Turn somebody else's ROS 2 bag into a recording that can be audited.",
    ),
    "import-video": ("ssp_eval.importers.cli:import_video", "Make a bag from a video file."),
    "labels": ("ssp_eval.labels.cli:labels", "Propose and check labels files."),
    "audit": ("ssp_eval.audit.cli:audit", "Prove that three recordings show the same event."),
    "twins": (
        "ssp_eval.twins.cli:twins",
        "Make recordings that differ from a simulated one in one cause.",
    ),
    "evaluate": (
        "ssp_eval.evaluate.cli:evaluate",
        "Replay bags through VLA bridges and score them.",
    ),
    "score": ("ssp_eval.score.cli:score", "Score records against labels (METHOD 5 and 6)."),
    "report": ("ssp_eval.report.cli:report", "Write the HTML report of evaluated cells."),
    "shortlist": (
        "ssp_eval.statistics.tables.shortlist:shortlist_command",
        "List which events go on to the track, and why.",
    ),
    "extract": ("ssp_eval.extract.cli:extract", "Extract slots with evidence from texts."),
    "package": (
        "ssp_eval.package.cli:package",
        "Make and verify evidence packages; log changes on site.",
    ),
    "bag": ("ssp_monitor.bag_tools.cli:bag", "Inspect, check and repair bags."),
    "replay": ("ssp_monitor.replay_cli:replay", "Publish a bag as it was recorded."),
    "faults": (
        "ssp_scenario_manager.cli.faults:faults",
        "Inject every fault at every stage of a run and judge what comes of it.",
    ),
    "iso": ("ssp_ot_controller.rehearsal.iso:iso", "Play and probe objects that speak ISO 22133."),
    "carla": (
        "ssp_scenario_manager.cli.carla:carla",
        "Measure whether a CARLA server does what a run relies on.",
    ),
    "bench": ("ssp_eval.bench:bench", "Measure each path beside its own lower bound."),
    "doctor": (
        "ssp_scenario_manager.cli.doctor:doctor",
        "Show what is installed, missing or broken.",
    ),
    "build-core": (
        "ssp_eval.checkout:build_core",
        "Compile the core of sessions to machine code (optional).",
    ),
    "check": ("ssp_eval.checkout:check", "Check format, lint and types of what changed."),
    "docs": ("ssp_eval.checkout:docs", "Build the site of the documentation."),
    "test": ("ssp_eval.checkout:test", "Run lint, types and all tests."),
}


# verb: what it imports only where it comes to need it; a demonstration imports it for all steps.
LATE: dict[str, tuple[str, ...]] = {
    "spec": ("ssp_ot_controller.camera.clip",),
    "run": ("ssp_ot_controller.sil.sumo_world",),
    "audit": ("dtwalign", "scipy.interpolate"),
    "report": ("statsmodels.stats.contingency_tables",),
    "package": ("ssp_eval.package.make",),
}

# What a researcher's machine, on which records are only scored, may do without.
NOT_EVERYWHERE = frozenset(
    {"rclpy", "ssp_msgs", "sensor_msgs", "builtin_interfaces", "libsumo", "numba"}
)


@contextmanager
def _without_collection() -> Iterator[None]:
    """Import without looking for cycles: what imports make stays, and the search takes a tenth."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


class VerbGroup(click.Group):
    """A group of whose commands some are loaded when they are called.

    Args:
        verbs: those, by name: ``module:function`` and a line of help.
    """

    def __init__(self, *args: Any, verbs: Mapping[str, tuple[str, str]], **given: Any) -> None:
        super().__init__(*args, **given)
        self._verbs = verbs

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [*super().list_commands(ctx), *self._verbs]

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in self._verbs:
            return super().get_command(ctx, name)
        place = self._verbs[name][0]
        module_name, function = place.split(":")
        with _without_collection():
            command = getattr(importlib.import_module(module_name), function)
        if not isinstance(command, click.Command):
            raise TypeError(f"{place} is no click command")
        return command

    def format_commands(self, _ctx: click.Context, formatter: click.HelpFormatter) -> None:
        own = [(name, command.get_short_help_str(80)) for name, command in self.commands.items()]
        with formatter.section("Commands"):
            formatter.write_dl([*own, *((name, text) for name, (_, text) in self._verbs.items())])


@click.group(cls=VerbGroup, verbs=VERBS, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="ssp")
def cli() -> None:
    """Orchestrate closed-track tests, and evaluate driving VLAs across three domains.

    Exit status: 0 done, 1 the check or the run failed, 2 wrong usage, 130 interrupted.
    """


_EMPTY_OPTION = re.compile(r"--[a-z][a-z-]*=")


def main(args: list[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    survive_lost_output()
    # No file model has a plugin, and pydantic looks for them among all installed packages. The
    # nodes of a session inherit it.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    os.environ.setdefault(*ONE_THREAD)  # before numpy is imported
    for line in (set_middleware_aside(os.environ), set_log_folder(os.environ)):
        if line:
            click.echo(f"ssp: {line}", err=True)
    with on_stop_signals(_interrupt):
        status = _run(args)
    if reason := lost_output():
        click.echo(f"error: standard output: {reason}", err=True)
        return status or 1
    return status


def _interrupt(_: Signals) -> None:
    """End a command in order, as Ctrl-C does, for a closed terminal or SIGTERM."""
    raise KeyboardInterrupt


def _check_names(args: Sequence[str]) -> None:
    """Raise InputError for bytes that are no UTF-8: files and messages can't hold such a name."""
    for what, text in [*(("the argument", arg) for arg in args), ("the folder here", os.getcwd())]:
        if not text.isascii() and any("\ud800" <= c <= "\udfff" for c in text):
            readable_text = os.fsencode(text).decode("utf-8", "backslashreplace")
            raise InputError(
                f"{what} {readable_text} is no UTF-8",
                remedy="rename the file or folder, or type the text in UTF-8",
            )


def _check_not_empty(args: Sequence[str]) -> None:
    """Raise UsageError for an empty argument, which as a path would be the folder here."""
    if args[:1] == ["test"]:  # its arguments are pytest's
        return
    for place, text in enumerate(args):
        if text and not _EMPTY_OPTION.fullmatch(text):
            continue
        where = text or (f"the argument after {args[place - 1]}" if place else "the command")
        raise click.UsageError(
            f"{where} is empty; give a value or leave it out (a variable of the shell may be unset)"
        )


def _run(args: list[str] | None) -> int:
    try:
        arguments = sys.argv[1:] if args is None else args
        _check_names(arguments)
        _check_not_empty(arguments)
        result = cli.main(args=args, prog_name="ssp", standalone_mode=False)
        return result if isinstance(result, int) else 0
    except click.exceptions.Exit as stop:
        return stop.exit_code
    except click.Abort:
        click.echo("interrupted", err=True)
        return 130
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in NOT_EVERYWHERE:
            raise
        from ssp_core.console import report_error

        report_error(
            f"{error.name} is not installed here, and this command needs it; start it through "
            "./ssp in the source tree, or source a ROS 2 Jazzy workspace (`ssp doctor` says more)"
        )
        return 1
    except SspError as error:
        from ssp_core.console import report_error

        report_error(str(error))
        return 1
    except OSError as error:
        remedy = SYSTEM_REMEDIES.get(error.errno or 0)
        if remedy is None:
            raise
        from ssp_core.console import report_error

        report_error(f"{error.filename or 'the disk'}: {error.strerror}; {remedy}")
        return 1


def entry() -> NoReturn:
    """Run the command line as a process of its own, the console script ``ssp``.

    It ends without the interpreter's own end, which takes a tenth of a short command.
    """
    search_as_usual()
    status = 1
    atexit.register(lambda: end_at_once(status))  # the first that is registered is called last
    status = main()
    sys.exit(status)


if __name__ == "__main__":
    entry()
