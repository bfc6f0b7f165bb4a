"""``ssp shortlist``: which events of the two virtual stages are worth a day on the track."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path

import click
from rich.table import Table

from ssp_core import __version__, console
from ssp_core.errors import InputError
from ssp_core.files.writing import write_text
from ssp_core.hashing import sha256_file
from ssp_core.options import Number, WholeNumber
from ssp_core.run_file.shortlist import LeftOut, Limits, ListedEvent, Shortlist
from ssp_core.vocabulary import DomainWord
from ssp_eval.evaluate.store.cell_file import CELL_FILE, losses_text, outages
from ssp_eval.evaluate.store.results import CellData, load_cells
from ssp_eval.score.aggregate import EQUAL, mean, ranks
from ssp_eval.score.cell import STAGES
from ssp_eval.score.engine import cell_terms
from ssp_eval.statistics.bootstrap import RESAMPLES, SEED, bootstrap_records
from ssp_eval.statistics.rows import CellRow, one_scale, rows_from_cells
from ssp_eval.statistics.table import some
from ssp_eval.statistics.tables.statistics import STAGE_NAMES

FIRST: DomainWord = "synthetic"
SECOND: DomainWord = "simulation"
DEFAULT_LIMITS = Limits(no_response=0.5, turned=0.25, width=0.3, most=10)

# By model, the cells of one event in one stage: a cell and its row.
Stage = Mapping[str, tuple[CellRow, CellData]]


def shortlist(
    first: Sequence[CellData], second: Sequence[CellData], limits: Limits, resamples: int
) -> Shortlist:
    """Rank the events that both stages evaluated.

    Args:
        first: cells of the synthetic stage; those of other domains are left aside.
        second: cells of the stage that follows.
        limits: of the ranking, and how many events are listed.
        resamples: of the intervals.

    Raises:
        InputError: a stage has no scored cell of a model.
    """
    before, after = _stage(first, FIRST), _stage(second, SECOND)
    left_out: list[LeftOut] = []
    events = []
    models: set[str] = set()
    apart: set[str] = set()
    left_out += _with_outages((before, after))
    lost = {one.scenario for one in left_out}
    for scenario in sorted((before.keys() | after.keys()) - lost):
        one, other = before.get(scenario, {}), after.get(scenario, {})
        common = sorted(one.keys() & other.keys())
        apart |= one.keys() ^ other.keys()
        if why := _not_comparable(one, other, common):
            left_out.append(LeftOut(scenario=scenario, why=why))
            continue
        models |= set(common)
        pair = ({m: one[m] for m in common}, {m: other[m] for m in common})
        events.append(_listed(scenario, *pair, limits, resamples))
    return Shortlist(
        software=f"ssp {__version__}",
        limits=limits,
        models=sorted(models),
        events=_ranked(events, limits.most),
        left_out=left_out,
        notes=_notes(first, second, sorted(apart)),
    )


def _with_outages(stages: Sequence[Mapping[str, Stage]]) -> list[LeftOut]:
    """Return events that lost answers to an outage, so that a model's response is unknown."""
    lost: dict[str, set[str]] = {}
    for _, cell in (one for stage in stages for cells in stage.values() for one in cells.values()):
        missing = losses_text(outages(cell.facts.answers.missing_by_kind))
        if missing:
            lost.setdefault(cell.scenario, set()).add(f"{cell.model} ({cell.domain}): {missing}")
    return [
        LeftOut(scenario=name, why=f"{some(sorted(why), '; ')}; ask again with --retry-errors")
        for name, why in sorted(lost.items())
    ]


def _stage(cells: Sequence[CellData], domain: DomainWord) -> dict[str, Stage]:
    """Collect by scenario the scored cells of a domain, controls left out."""
    rows = rows_from_cells(list(cells))
    row_ids = {id(row) for row in one_scale(rows)}
    stages: dict[str, dict[str, tuple[CellRow, CellData]]] = {}
    for row, cell in zip(rows, cells, strict=True):
        usable = cell.score is not None and not row.control and id(row) in row_ids
        if usable and row.domain == domain:
            stages.setdefault(row.scenario, {})[row.model] = (row, cell)
    if not stages:
        there = sorted({row.domain for row in rows})
        raise InputError(
            f"holds no scored cell of a model in the domain {domain}",
            file=cells[0].folder.parents[1] if cells else None,
            value=", ".join(there),
            remedy="give the campaign of the synthetic stage first, then that of the simulation",
        )
    return dict(stages)


def _not_comparable(one: Stage, other: Stage, common: Sequence[str]) -> str:
    if not one or not other:
        return f"it has no scored cell in {SECOND if one else FIRST}"
    if not common:
        return "no model was scored in both stages"
    versions = {cell.facts.event_version for _, cell in (*one.values(), *other.values())}
    if len(versions) > 1:
        return (
            f"its recordings are of {len(versions)} versions of K*: {', '.join(sorted(versions))}"
        )
    scales = {row.thresholds for row, _ in (*one.values(), *other.values())}
    return "its stages were scored with different thresholds" if len(scales) > 1 else ""


def _listed(scenario: str, one: Stage, other: Stage, limits: Limits, resamples: int) -> ListedEvent:
    both = (*one.values(), *other.values())
    silent = [row for row, _ in both if not row.rsr]
    orders = [
        ranks({model: row.ivcs for model, (row, _) in stage.items()}) for stage in (one, other)
    ]
    pairs = list(combinations(sorted(one), 2))
    turned = [pair for pair in pairs if _gap(one, pair) * _gap(other, pair) < 0]
    width = _width(both, resamples)
    failures = {
        stage: (_count(one, stage), _count(other, stage))
        for stage in STAGES
        if _count(one, stage) or _count(other, stage)
    }
    shares = (len(silent) / len(both), len(turned) / len(pairs) if pairs else 0.0, width)
    return ListedEvent(
        scenario=scenario,
        event_version=both[0][1].facts.event_version,
        rank=None,
        priority=sum(shares) / len(shares),
        no_response=shares[0],
        turned=shares[1],
        width=width,
        ranks={model: (orders[0][model] or 0, orders[1][model] or 0) for model in sorted(one)},
        first_failures=failures,
        reasons=_reasons(shares, limits, silent, turned, failures),
        cells=sorted({sha256_file(cell.folder / CELL_FILE) for _, cell in both}),
    )


def _gap(stage: Stage, pair: tuple[str, str]) -> float:
    """Compute by how much the first of two models leads by IVCS; 0 where they are equal."""
    first, second = (stage[model][0].ivcs or 0.0 for model in pair)
    return 0.0 if abs(first - second) <= EQUAL else first - second


def _width(cells: Sequence[tuple[CellRow, CellData]], resamples: int) -> float:
    terms = [
        (row, cell_terms(cell.labels, cell.records, cell.thresholds))
        for row, cell in cells
        if cell.score is not None
    ]
    estimates_by_cell = bootstrap_records(terms, (), resamples, SEED).cells
    ends = [estimates["ivcs"].percentile for estimates in estimates_by_cell.values()]
    widths = [e.high - e.low for e in ends if e.low is not None and e.high is not None]
    # Of a single label nothing is known: that is as wide as it gets.
    return min(mean([*widths, *[1.0] * (len(ends) - len(widths))]).value or 0.0, 1.0)


def _count(stage: Stage, failure: str) -> int:
    return sum(
        cell.score.details.first_failures[failure]
        for _, cell in stage.values()
        if cell.score is not None
    )


def _reasons(
    shares: tuple[float, float, float],
    limits: Limits,
    silent: Sequence[CellRow],
    turned: Sequence[tuple[str, str]],
    failures: Mapping[str, tuple[int, int]],
) -> list[str]:
    """List why an event is a candidate, strongest findings in words; empty where it is none."""
    reasons = []
    if silent and shares[0] >= limits.no_response:
        names = sorted(f"{row.model} ({row.domain})" for row in silent)
        worst = sorted(failures, key=lambda stage: -sum(failures[stage]))[:2]
        stages = "; ".join(
            f"{STAGE_NAMES[stage]} fails first at {failures[stage][0]} + {failures[stage][1]} "
            "label times"
            for stage in worst
        )
        reasons.append(f"no risk response: {some(names)}; {stages}")
    if turned and shares[1] >= limits.turned:
        pairs = [f"{a} and {b}" for a, b in turned]
        reasons.append(f"ranks turn from {FIRST} to {SECOND}: {some(pairs, '; ')}")
    if shares[2] >= limits.width:
        reasons.append(f"intervals of IVCS over labels are {shares[2]:.2f} wide")
    return reasons


def _ranked(events: Sequence[ListedEvent], most: int) -> list[ListedEvent]:
    """Rank candidates by priority, at most so many; the rest follow without rank."""
    candidates = [one for one in events if one.reasons]
    order = ranks({str(place): one.priority for place, one in enumerate(candidates)})
    listed = [
        one.model_copy(update={"rank": order[str(place)]})
        for place, one in enumerate(candidates)
        if (order[str(place)] or 0) <= most
    ]
    scenarios = {one.scenario for one in listed}
    rest = [one for one in events if one.scenario not in scenarios]
    listed.sort(key=lambda one: (one.rank or 0, one.scenario))
    return [*listed, *sorted(rest, key=lambda one: (-one.priority, one.scenario))]


def _notes(
    first: Sequence[CellData], second: Sequence[CellData], apart: Sequence[str]
) -> list[str]:
    notes = []
    if apart:
        notes.append(
            f"Not scored in both stages of every event, and left out there: {some(apart)}."
        )
    outside = sorted(
        {
            f"{cell.scenario} / {cell.domain}: {cell.admission}"
            for cells, domain in ((first, FIRST), (second, SECOND))
            for cell in cells
            if cell.domain == domain and cell.score is not None and cell.admission != "admitted"
        }
    )
    if outside:
        notes.append(
            f"No audit admitted these recordings, so that a difference between the stages may be "
            f"one of content: {some(outside, '; ')}."
        )
    return notes


_PATH = click.Path(path_type=Path)
_SHARE = Number(0, 1)
_WIDEST = 400
_EXPLAINED = (
    "no response: share of cells with RSR = F; turned: share of pairs of models whose order by "
    "IVCS turns from synthetic to simulation; width: mean width of the 95 % intervals of IVCS "
    "over labels; priority: their mean, which ranks the candidates; equal ones share a rank."
)


@click.command("shortlist")
@click.argument("syn_campaign", type=_PATH)
@click.argument("sim_campaign", type=_PATH)
@click.option(
    "--no-response",
    type=_SHARE,
    default=DEFAULT_LIMITS.no_response,
    show_default=True,
    help="Least share of cells without a risk response that makes a candidate.",
)
@click.option(
    "--turned",
    type=_SHARE,
    default=DEFAULT_LIMITS.turned,
    show_default=True,
    help="Least share of pairs of models in reversed order that makes a candidate.",
)
@click.option(
    "--width",
    type=_SHARE,
    default=DEFAULT_LIMITS.width,
    show_default=True,
    help="Least mean width of the intervals of IVCS that makes a candidate.",
)
@click.option(
    "--most",
    type=WholeNumber(1),
    default=DEFAULT_LIMITS.most,
    show_default=True,
    help="Number of ranks to list.",
)
@click.option(
    "--resamples",
    type=WholeNumber(100, 1_000_000),
    default=RESAMPLES,
    show_default=True,
    help="Resamples of the bootstrap for the intervals.",
)
@click.option(
    "--out",
    type=_PATH,
    metavar="FILE.json",
    help="Also write the list, for `ssp compile --shortlist`.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the list as JSON (ssp.shortlist/1).")
def shortlist_command(
    syn_campaign: Path,
    sim_campaign: Path,
    no_response: float,
    turned: float,
    width: float,
    most: int,
    resamples: int,
    out: Path | None,
    as_json: bool,
) -> int:
    """List which events go on to the track, and why.

    SYN_CAMPAIGN and SIM_CAMPAIGN are campaign folders of `ssp evaluate`; the first gives the cells
    of the domain synthetic, the second those of simulation. A folder that holds both is given
    twice. Exit status 1 if no event is a candidate.
    """
    limits = Limits(no_response=no_response, turned=turned, width=width, most=most)
    first = load_cells(syn_campaign)
    second = first if sim_campaign == syn_campaign else load_cells(sim_campaign)
    for cell in (*first, *second):
        if cell.changed:
            raise InputError(
                cell.changed,
                file=cell.folder,
                remedy="give `ssp evaluate` its command again; what is stored isn't asked again",
            )
    listing = shortlist(first, second, limits, resamples)
    text = listing.model_dump_json(by_alias=True, indent=1) + "\n"
    if out is not None:
        write_text(out, text)
    if as_json:
        click.echo(text, nl=False)
    else:
        _show(listing)
    return 0 if any(one.rank for one in listing.events) else 1


def _show(listing: Shortlist) -> None:
    table = Table(box=None, pad_edge=False)
    table.add_column("rank", justify="right", no_wrap=True)
    table.add_column("event", no_wrap=True)
    table.add_column("version", no_wrap=True)
    for name in ("no response", "turned", "width", "priority"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("why")
    for one in listing.events:
        table.add_row(*_fields(one))
    unbounded = console.out.options.update(max_width=_WIDEST)
    table.width = console.out.measure(table, options=unbounded).maximum
    console.out.print(table)
    limits = listing.limits
    console.note(_EXPLAINED)
    console.note(
        f"candidates: no response ≥ {limits.no_response:g}, turned ≥ {limits.turned:g}, or width ≥ "
        f"{limits.width:g}"
    )
    for left in listing.left_out:
        console.note(f"{left.scenario}: left out: {left.why}")
    for note in listing.notes:
        console.note(note)


def _fields(one: ListedEvent) -> tuple[str, ...]:
    shares = (one.no_response, one.turned, one.width, one.priority)
    return (
        "–" if one.rank is None else str(one.rank),
        one.scenario,
        one.event_version[:19],
        *(f"{share:.2f}" for share in shares),
        "; ".join(one.reasons) or "no candidate",
    )
