"""``ssp report``: the page of a campaign; tables, statistics and figures of any set of cells."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import click
from click.core import ParameterSource

from ssp_core import console
from ssp_core.files.folders import new_files, taken_folder
from ssp_core.options import WholeNumber
from ssp_eval.causes.answers import CellAnswers
from ssp_eval.causes.findings import answers_in, moved_by
from ssp_eval.causes.tables import moved_tables
from ssp_eval.data.loop import is_loop_campaign
from ssp_eval.evaluate.store.results import CellData, cell_files
from ssp_eval.figures.write import GROUPS, FiguresOutcome, write_figures
from ssp_eval.report.making import MOST_ANALYSED, Making, runs_of, statistics_of
from ssp_eval.report.page import write_report
from ssp_eval.statistics.bootstrap import RESAMPLES, SEED
from ssp_eval.statistics.constants import OfScenario, constant_rows, constant_table
from ssp_eval.statistics.csv_rows import rows_from_csv
from ssp_eval.statistics.rows import CellRow, scale
from ssp_eval.statistics.statistics import Options, steps_of
from ssp_eval.statistics.table import FORMATS, Table, write_tables
from ssp_eval.statistics.tables.labels import label_table
from ssp_eval.statistics.tables.notices import everywhere, notice_table, notices
from ssp_eval.statistics.tables.responses import named_audits, response_table
from ssp_eval.statistics.tables.scores import all_tables, with_notices
from ssp_eval.statistics.tables.statistics import (
    failures_by_cell,
    failures_by_model,
    write_statistics,
)

# It needs the frames of a campaign.
PHASES = "phases"
CHOICES = (*GROUPS, PHASES)


@dataclass(frozen=True)
class FigureSelection:
    """The figures that were asked for.

    Args:
        reference: model that others are compared to, None: the best by IVCS.
        only: some of CHOICES; empty: all.
    """

    folder: Path
    reference: str | None
    only: Sequence[str]


def draw_figures(
    selection: FigureSelection,
    rows: Sequence[CellRow],
    campaign: Path | None = None,
    cells: Sequence[CellData] = (),
) -> None:
    """Write figures, all of them or none; print the figures left out, and why.

    Args:
        selection: folder, groups and reference.
        rows: all of them.
        campaign: whose frames are drawn on; None: there are none.
        cells: of the campaign, for the frames.

    Raises:
        InputError: the reference is no model, or a file can't be read.
        HostError: the disk doesn't take them.
    """
    groups = [name for name in selection.only if name in GROUPS]
    outcomes: list[FiguresOutcome] = []
    with new_files(selection.folder) as scratch, console.progress("figures", None) as bar:

        def advance(name: str) -> None:
            bar.update(bar.task_ids[0], advance=1, description=name)

        if groups or not selection.only:
            outcomes.append(write_figures(rows, scratch, selection.reference, groups, advance))
        if campaign is not None and (not selection.only or PHASES in selection.only):
            # Pictures need OpenCV and PyAV, which figures of a CSV file do without.
            from ssp_eval.figures.phases import write_phase_frames

            limit = not selection.only
            outcomes.append(write_phase_frames(campaign, scratch, cells, advance, limit))
    for name, reason in (one for outcome in outcomes for one in outcome.left_out):
        console.note(f"{name}: not drawn: {reason}")
    click.echo(f"{selection.folder} ({sum(len(outcome.files) for outcome in outcomes)} files)")


TABLES = "tables"


class _Formats(click.ParamType[tuple[str, ...]]):
    """``csv,latex``: names of formats, separated by commas."""

    name = "formats"

    def convert(
        self, value: str | tuple[str, ...], param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, ...]:
        if isinstance(value, tuple):
            return value
        names = tuple(dict.fromkeys(part.strip() for part in value.split(",")))
        for name in names:
            if name not in FORMATS:
                self.fail(f"{name!r} is no format; known: {', '.join(FORMATS)}", param, ctx)
        return names


def _take(*folders: Path | None) -> None:
    """Lock the folders that are written into against other commands, until this command ends."""
    for folder in sorted({one.resolve() for one in folders if one is not None}):
        click.get_current_context().with_resource(taken_folder(folder))


@dataclass(frozen=True)
class _FileSelection:
    """The files that are to be written beside the page."""

    folder: Path
    formats: Sequence[str]
    reference: str | None
    options: Options
    expected: Sequence[str] = ()


@click.command()
@click.argument("out_dir", type=click.Path(path_type=Path), required=False)
@click.option(
    "--from-cells",
    type=click.Path(path_type=Path),
    metavar="FILE.csv",
    help="Component scores instead of a campaign; needs --out.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Where the analysis of --from-cells goes.",
)
@click.option(
    "--repeat",
    "repeats",
    type=click.Path(path_type=Path),
    multiple=True,
    metavar="DIR",
    help="Another campaign with repetitions of the same cells; repeatable.",
)
@click.option(
    "--expect",
    "expected",
    multiple=True,
    metavar="SCENARIO",
    help="Scenario that was planned; the report says so if it has no cell. Repeatable.",
)
@click.option(
    "--tables",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Write all tables and statistics.json into DIR.",
)
@click.option(
    "--format",
    "formats",
    type=_Formats(),
    default=",".join(FORMATS),
    show_default=True,
    help="Formats of the tables.",
)
@click.option(
    "--figures",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Draw all figures into DIR: SVG, PDF and PNG with a caption each.",
)
@click.option(
    "--only",
    type=click.Choice(CHOICES),
    multiple=True,
    help="Draw only these groups of figures; repeatable.",
)
@click.option(
    "--open-loop",
    "open_loop",
    type=click.Path(path_type=Path),
    multiple=True,
    metavar="DIR",
    help="With a campaign of driven runs: a campaign of `ssp evaluate` on the same events, whose "
    "scores are compared with the drivers' headlines. Repeatable.",
)
@click.option("--reference", metavar="NAME", help="Model that the others are compared with.")
@click.option(
    "--resamples",
    type=WholeNumber(min=100, max=1_000_000),
    default=RESAMPLES,
    show_default=True,
    help="Bootstrap resamples, and number of random sets of weights.",
)
@click.option(
    "--block",
    type=WholeNumber(min=1),
    metavar="LABELS",
    help="Block length of the bootstrap in neighbouring labels; 1 draws each alone. Default: the "
    "cube root of a clip's number of labels.",
)
@click.option(
    "--seed",
    type=WholeNumber(min=0),
    default=SEED,
    show_default=True,
    help="Seed of all random numbers; the same one gives the same files.",
)
def report(
    out_dir: Path | None,
    from_cells: Path | None,
    out: Path | None,
    repeats: tuple[Path, ...],
    expected: tuple[str, ...],
    tables: Path | None,
    formats: tuple[str, ...],
    figures: Path | None,
    only: tuple[str, ...],
    open_loop: tuple[Path, ...],
    reference: str | None,
    resamples: int,
    block: int | None,
    seed: int,
) -> int:
    """Write OUT_DIR/index.html: one file with the pictures in it, readable offline.

    OUT_DIR is a folder of `ssp evaluate`, or of `ssp loop`, whose page shows driven runs.

    With --tables it also writes tables and statistics as files; with --from-cells and --out only
    these, from a CSV file of component scores. A page of more than 500 cells shows statistics only
    with --tables. A cell that was changed after `ssp evaluate`, or whose admission its audit
    doesn't confirm, is refused: the report leaves it out, and the exit status is 1.
    """
    options = Options(resamples, seed, block)
    if only and figures is None:
        raise click.UsageError("--only needs --figures DIR")
    if tables is None and (from_cells is None or out is None) and _is_on_command_line("formats"):
        raise click.UsageError("--format needs --tables DIR, or --out DIR with --from-cells")
    figure_selection = None if figures is None else FigureSelection(figures, reference, only)
    if from_cells is not None:
        if out_dir is not None or repeats:
            raise click.UsageError("--from-cells stands alone: give no campaign beside it")
        _check_cells_options(
            out, only, expected, block, is_alone=figure_selection is not None and not tables
        )
        _take(out, tables, figures)
        rows = rows_from_csv(from_cells, console.note)
        return _report_cells(
            rows,
            out,
            figure_selection,
            lambda folder: _FileSelection(
                tables or folder / TABLES, formats, reference, options, expected
            ),
        )
    out_dir = _campaign_folder(out_dir, out)
    if is_loop_campaign(out_dir):
        is_plain = figure_selection is None and not repeats
        return _report_loop(out_dir, tables, formats, open_loop, is_plain=is_plain)
    if open_loop:
        raise click.UsageError("--open-loop goes with a campaign of `ssp loop`")
    _check_outputs(tables is not None or figure_selection is not None, reference, repeats)
    _take(out_dir if out_dir.is_dir() else None, tables, figures)
    changed: dict[Path, str] = {}

    def check(cell: CellData) -> None:
        if cell.changed:
            changed[cell.folder] = cell.changed

    analysis: Sequence[Table] = ()
    repeated: Sequence[CellAnswers] = ()
    if tables or figure_selection or len(cell_files(out_dir)) <= MOST_ANALYSED:
        data, rows, constants = _read((out_dir, *repeats))
        for cell in data:
            check(cell)
        if figure_selection is not None:
            figure_rows = [*rows, *constant_rows(constants)]
            draw_figures(figure_selection, figure_rows, out_dir, data[: len(cell_files(out_dir))])
        repeated = answers_in(data[len(cell_files(out_dir)) :])
        if tables is not None:
            file_selection = _FileSelection(tables, formats, reference, options, expected)
            audits = named_audits((out_dir, *repeats), (cell.facts for cell in data))
            audit_tables = [label_table(data, audits)]
            if (responses := response_table(audits)) is not None:
                audit_tables.append(responses)
            analysis = _analyse(rows, data, file_selection, tables, audit_tables, constants)
        elif len(data) <= MOST_ANALYSED:
            analysis = _statistics_with_progress(rows, data, options, constants)
        # A page is made of one cell after the other; it needs its memory more than a second read.
        del data, rows
    with console.progress("report", None) as bar:
        task = bar.task_ids[0]
        target = write_report(
            out_dir,
            lambda done, of: bar.update(task, completed=done, total=of),
            analysis=analysis,
            on_cell=check,
            repeated=repeated,
            expected=expected,
            carried=Making(
                expected=expected,
                resamples=resamples,
                seed=seed,
                block=block,
                tables=tables is not None,
                repeats=len(repeats),
            ).model_dump_json(),
        )
    for folder, why in changed.items():
        console.report_error(f"{folder}: refused: {why}")
    size_mb = target.stat().st_size / 1e6
    click.echo(f"{target} ({size_mb:.1f} MB)")
    return 1 if changed else 0


def _campaign_folder(out_dir: Path | None, out: Path | None) -> Path:
    if out_dir is None:
        raise click.UsageError("give the folder of a campaign, or --from-cells FILE.csv")
    if out is not None:
        raise click.UsageError("--out belongs to --from-cells; use --tables DIR")
    return out_dir


def _report_loop(
    folder: Path,
    tables: Path | None,
    formats: Sequence[str],
    open_loop: Sequence[Path],
    *,
    is_plain: bool,
) -> int:
    """Write the page, and the tables where they are asked for, of a campaign of driven runs."""
    # It needs what runs sessions, which reports of scores do without.
    from ssp_eval.closed_loop.folder import load_loop
    from ssp_eval.closed_loop.page import tables_of, write_loop_report
    from ssp_eval.closed_loop.prediction import prediction_table
    from ssp_eval.closed_loop.words import words_tables

    if not is_plain:
        raise click.UsageError("a campaign of driven runs has a page and tables: see --tables DIR")
    _take(folder, tables)
    campaign = load_loop(folder)
    further = words_tables(campaign)
    if open_loop:
        cells, rows, _ = runs_of(open_loop)
        both = zip(cells, rows, strict=True)
        undriven = [row for cell, row in both if not cell.facts.clip.driven_by]
        further.append(prediction_table(campaign, undriven))
    target = write_loop_report(campaign, further)
    if tables is not None:
        files = write_tables(tables, [*tables_of(campaign), *further], formats)
        click.echo(f"{tables} ({len(files)} files)")
    click.echo(f"{target} ({target.stat().st_size / 1e6:.1f} MB)")
    return 0


def _check_outputs(is_wanted: bool, reference: str | None, repeats: tuple[Path, ...]) -> None:
    if not is_wanted and (reference is not None or repeats):
        raise click.UsageError("--reference and --repeat need --tables DIR or --figures DIR")


def _report_cells(
    rows: Sequence[CellRow],
    out: Path | None,
    figure_selection: FigureSelection | None,
    selection_of: Callable[[Path], _FileSelection],
) -> int:
    """Draw figures and write tables of component scores; returns the exit status."""
    if figure_selection is not None:
        draw_figures(figure_selection, rows)
    if out is not None:
        _analyse(rows, (), selection_of(out), statistics=out)
    return 0


def _check_cells_options(
    out: Path | None,
    only: tuple[str, ...],
    expected: tuple[str, ...],
    block: int | None,
    *,
    is_alone: bool,
) -> None:
    """Refuse the options that --from-cells can't follow.

    Args:
        out: folder of the tables; None: not asked for.
        only: figures that are asked for.
        expected: scenarios of --expect.
        block: labels that are drawn together, of --block.
        is_alone: figures are all that is asked for.
    """
    if block is not None:
        raise click.UsageError("--block is of labels, of which --from-cells knows nothing")
    if out is None and (_is_on_command_line("resamples") or _is_on_command_line("seed")):
        raise click.UsageError("--resamples and --seed need --out DIR: figures draw nothing")
    if out is None and expected:
        raise click.UsageError("--expect needs --out DIR: figures name no scenario")
    if PHASES in only:
        raise click.UsageError(f"{PHASES} needs the frames of a campaign, not --from-cells")
    if out is None and not is_alone:
        raise click.UsageError("--from-cells needs --out DIR, or --figures DIR alone")


def _is_on_command_line(option: str) -> bool:
    """Return True where an option that has a default stands on the command line."""
    source = click.get_current_context().get_parameter_source(option)
    return source is ParameterSource.COMMANDLINE


def _read(
    folders: Iterable[Path],
) -> tuple[list[CellData], list[CellRow], list[OfScenario]]:
    """Read the cells of campaigns as runs_of does, with a progress bar."""
    with console.progress("read cells", None) as bar:
        task, total = bar.task_ids[0], 0

        def advance_over(count: int) -> Callable[[], None]:
            nonlocal total
            total += count
            bar.update(task, total=total)
            return partial(bar.advance, task)

        return runs_of(folders, advance_over)


def _statistics_with_progress(
    rows: Sequence[CellRow],
    data: Sequence[CellData],
    options: Options,
    constants: Sequence[OfScenario],
) -> list[Table]:
    with console.progress("statistics", steps_of(rows, bool(data))) as bar:
        return statistics_of(rows, data, options, constants, partial(bar.advance, bar.task_ids[0]))


def _analyse(
    rows: Sequence[CellRow],
    data: Sequence[CellData],
    selection: _FileSelection,
    statistics: Path,
    of_audits: Sequence[Table] = (),
    constants: Sequence[OfScenario] = (),
) -> list[Table]:
    """Compute everything before anything is written."""
    notice_list = notices(rows, data, selection.expected)
    shown_rows = [*rows, *constant_rows(constants)]
    plain = [*all_tables(shown_rows, selection.reference), notice_table(notice_list)]
    if constants:
        plain.append(constant_table(constants))
    if data:
        plain += [failures_by_cell(data), failures_by_model(data)]
    plain += of_audits
    moved = moved_by(data)
    plain += [] if moved is None else moved_tables(moved)
    statistics_tables = with_notices(
        _statistics_with_progress(rows, data, selection.options, constants), everywhere(notice_list)
    )
    plain = with_notices(plain, everywhere(notice_list))
    tables = [*plain, *statistics_tables]
    with new_files(statistics) as scratch, console.progress("tables", len(tables)) as bar:
        advance = partial(bar.advance, bar.task_ids[0])
        target = write_statistics(
            scratch, statistics_tables, selection.options, notice_list, scale(rows)
        )
        paths = write_tables(selection.folder, tables, selection.formats, advance)
    click.echo(f"{selection.folder} ({len(paths)} files)")
    click.echo(f"{statistics / target.name}")
    return statistics_tables
