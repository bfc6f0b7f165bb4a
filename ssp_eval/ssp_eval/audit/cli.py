"""``ssp audit``: do three recordings show the same event? And the verbs under it."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
from rich.table import Table

from ssp_core import console
from ssp_core.errors import InputError
from ssp_core.files.folders import taken_folder
from ssp_core.files.writing import write_json, write_text
from ssp_eval.audit.judge import ACCEPTED, judge_files
from ssp_eval.audit.page import draw, render
from ssp_eval.data.audit import AUDIT_FILE, HARDLY_VISIBLE_PX, PAGE_FILE, Audit, RecordingEntry
from ssp_eval.data.response import PairEntry
from ssp_eval.response.compare import load_limits
from ssp_scenario_manager.event_spec.load import load_event

# verb: (module:function, one line of help); imported when it is used.
VERBS = {
    "observe": (
        "ssp_eval.observations.cli:observe",
        "Look at a recording: make the page, or seal what was seen.",
    ),
    "agree": (
        "ssp_eval.observations.cli:agree_command",
        "Compare two persons' observations of a recording.",
    ),
    "declare": (
        "ssp_eval.audit.declare:declare",
        "Say what took part in a live session: a named person's word.",
    ),
}


class AuditCommand(click.Command):
    """A command with arguments of its own, and verbs where the first argument names one."""

    def make_context(
        self,
        info_name: str | None,
        args: list[str],
        parent: click.Context | None = None,
        **extra: Any,
    ) -> click.Context:
        if args and args[0] in VERBS:
            module, function = VERBS[args[0]][0].split(":")
            command: click.Command = getattr(importlib.import_module(module), function)
            return command.make_context(f"{info_name} {args[0]}", args[1:], parent, **extra)
        return super().make_context(info_name, args, parent, **extra)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        super().format_options(ctx, formatter)
        with formatter.section("Other commands"):
            formatter.write_dl(
                [(f"{ctx.command_path} {name}", text) for name, (_, text) in VERBS.items()]
            )


_PATH = click.Path(path_type=Path)
_WIDEST = 300


@click.command(cls=AuditCommand)
@click.argument("synthetic", metavar="SYN", type=_PATH)
@click.argument("simulation", metavar="SIM", type=_PATH)
@click.argument("physical", metavar="PHY", type=_PATH)
@click.option("--out", type=_PATH, required=True, help="Folder for audit.json and audit.html.")
@click.option(
    "--event", "event_name", metavar="K*", help="K* by name or file. Default: the one in the bags."
)
@click.option(
    "--limits",
    "limits_file",
    type=_PATH,
    metavar="FILE",
    help="Limits within which responses count as alike. Default: the shipped ones.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the audit as JSON.")
@click.option("--force", is_flag=True, help="Replace an existing audit in the folder.")
def audit(
    synthetic: Path,
    simulation: Path,
    physical: Path,
    out: Path,
    event_name: str | None,
    limits_file: Path | None,
    as_json: bool,
    force: bool,
) -> int:
    """Check three recordings of one event against its K* and each other (METHOD 4).

    SYN, SIM and PHY are bag directories, or run folders that hold bag/. Their states are measured;
    observation files and labels.json are looked up beside each bag. Exit status 0 when all three
    are admitted, 1 when one is refused.
    """
    click.get_current_context().with_resource(taken_folder(out))
    for file in (out / AUDIT_FILE, out / PAGE_FILE):
        if file.exists() and not force:
            raise InputError("exists already", file=file, remedy="give --force to replace it")
    event = None if event_name is None else load_event(event_name)[0]
    limits = None if limits_file is None else load_limits(limits_file)
    with console.progress("measuring", 9) as bar:
        task = bar.task_ids[0]
        paths = (synthetic, simulation, physical)
        judgement = judge_files(paths, event, limits, lambda: bar.advance(task))
        bar.update(task, description="drawing")
        page_pictures = draw(judgement.examined, lambda _done, _of: bar.advance(task))
        for one in judgement.examined:
            one.whole.files.check_same()
        page = render(judgement.audit, page_pictures)
    value = judgement.audit.model_dump(mode="json", by_alias=True)
    write_json(out / AUDIT_FILE, value)
    write_text(out / PAGE_FILE, page)
    if as_json:
        click.echo(judgement.audit.model_dump_json(by_alias=True))
    else:
        show(judgement.audit)
        console.note(f"written to {out / AUDIT_FILE} and {out / PAGE_FILE}")
    return 0 if judgement.audit.admitted else 1


def show(report: Audit) -> None:
    """Print the audit as a table, and every reason under it."""
    table = Table(box=None, pad_edge=False)
    names = ("domain", "recording", "status", "evidence", "KPR", "EPD", "visible", "labels")
    for name in (*names, "primary reason"):
        table.add_column(name, no_wrap=True)
    for r in report.recordings:
        primary = r.reasons[0].text if r.reasons else "·"
        table.add_row(
            r.domain,
            r.name,
            r.status,
            r.evidence if r.observations is None else " and ".join(r.observations.observers),
            _number(r.kpr, 2),
            _number(r.epd, 3),
            _visible(r),
            "–" if r.labels is None else "/".join(map(str, r.labels.per_phase.values())),
            primary,
        )
    unbounded = console.out.options.update(max_width=_WIDEST)
    table.width = console.out.measure(table, options=unbounded).maximum
    console.out.print(table)
    if report.labels is not None:
        console.note(f"labels per phase: {report.labels}")
    for pair in [] if report.response is None else report.response.pairs:
        for line in response_lines(pair):
            console.note(line)
    for r in report.recordings:
        for reason in r.reasons:
            console.out.print(f"{r.domain}: {reason.text}: {reason.detail}", markup=False)
            for following in reason.consequences:
                console.out.print(f"  so {following.text}: {following.detail}", markup=False)
        for line in _notes(r):
            console.note(line)


def _notes(r: RecordingEntry) -> Iterator[str]:
    """Yield the remarks on a recording beside the reasons."""
    if r.labels is not None and (times_s := r.labels.hardly_visible_s):
        yield (
            f"{r.domain}: hardly visible, the critical object is under {HARDLY_VISIBLE_PX:g} px "
            f"high, at the labels of {', '.join(f'{t_s:.2f}' for t_s in times_s)} s"
        )
    yield f"{r.domain}: {r.domain_said_by}"
    for name in ("clip", ACCEPTED):
        if name in r.disclosures:
            about = f"{name}: " if name == ACCEPTED else ""
            yield f"{r.domain}: {about}{r.disclosures[name]}"
    if r.stand_in:
        yield f"{r.domain} is a software stand-in, not a vehicle"
    for contradiction in r.contradictions:
        yield f"{r.domain}: {contradiction}"
    for change in r.changes:
        if change.logged:
            late = ", entered after the run" if change.later else ""
            yield f"{r.domain}: {change.field} was changed on site by {change.who}{late}"


def response_lines(pair: PairEntry) -> list[str]:
    """Return the verdict on one pair of responses, why it is so, and what explains a difference."""
    text = f"response of {pair.comparison} against {pair.reference}: {pair.verdict}"
    if pair.rating is not None:
        text += f", ISO/TS 18571 {pair.rating.overall:.2f} ({pair.rating.grade})"
    notable = [cause.text for cause in pair.causes if cause.notable]
    return [text, *(f"  {line}" for line in (*pair.why, *notable))]


def _number(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def _visible(r: RecordingEntry) -> str:
    """Return the smallest share of an object or zone that must be visible."""
    sights = [*r.coverage.participants.values(), *([r.coverage.zone] if r.coverage.zone else [])]
    fractions = [sight.fraction for sight in sights if sight.fraction is not None]
    return f"{100 * min(fractions):.0f} %" if fractions else "–"
