"""``ssp shortlist``: candidates for the track, from the two virtual stages."""

from __future__ import annotations

from pathlib import Path

import click
from rich.table import Table

from ssp_core import console
from ssp_core.cli import Number
from ssp_core.errors import InputError
from ssp_core.files import write_text
from ssp_core.run_file.shortlist import Limits, Listed, Shortlist
from ssp_eval.analysis.bootstrap import RESAMPLES
from ssp_eval.report.load import load_cells
from ssp_eval.shortlist.rank import DEFAULT_LIMITS, shortlist

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
@click.option("--no-response", type=_SHARE, default=DEFAULT_LIMITS.no_response, show_default=True,
              help="A candidate from this share of cells without a risk response on.")  # fmt: skip
@click.option("--turned", type=_SHARE, default=DEFAULT_LIMITS.turned, show_default=True,
              help="Likewise, share of pairs of models whose order turns.")  # fmt: skip
@click.option("--width", type=_SHARE, default=DEFAULT_LIMITS.width, show_default=True,
              help="Likewise, mean width of the intervals of IVCS.")  # fmt: skip
@click.option("--most", type=click.IntRange(1), default=DEFAULT_LIMITS.most, show_default=True,
              help="Ranks that are listed.")  # fmt: skip
@click.option("--resamples", type=click.IntRange(100, 1_000_000), default=RESAMPLES,
              show_default=True, help="Of the intervals.")  # fmt: skip
@click.option("--out", type=_PATH, metavar="FILE.json",
              help="Also write the list, for `ssp compile --shortlist`.")  # fmt: skip
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

    SYN_CAMPAIGN and SIM_CAMPAIGN are campaign folders of `ssp evaluate`; of the first the cells of
    the domain synthetic count, of the second those of simulation. One folder that holds both is
    given twice. Exit status 1 where no event is a candidate.
    """
    limits = Limits(no_response=no_response, turned=turned, width=width, most=most)
    first = load_cells(syn_campaign)
    second = first if sim_campaign == syn_campaign else load_cells(sim_campaign)
    for cell in (*first, *second):
        if cell.changed:
            raise InputError(
                cell.changed, file=cell.folder,
                remedy="give `ssp evaluate` its command again; what is stored isn't asked again",
            )  # fmt: skip
    found = shortlist(first, second, limits, resamples)
    text = found.model_dump_json(by_alias=True, indent=1) + "\n"
    if out is not None:
        write_text(out, text)
    if as_json:
        click.echo(text, nl=False)
    else:
        _show(found)
    return 0 if any(one.rank for one in found.events) else 1


def _show(found: Shortlist) -> None:
    table = Table(box=None, pad_edge=False)
    table.add_column("rank", justify="right", no_wrap=True)
    table.add_column("event", no_wrap=True)
    table.add_column("version", no_wrap=True)
    for name in ("no response", "turned", "width", "priority"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("why")
    for one in found.events:
        table.add_row(*_fields(one))
    unbounded = console.out.options.update(max_width=_WIDEST)
    table.width = console.out.measure(table, options=unbounded).maximum
    console.out.print(table)
    limits = found.limits
    console.note(_EXPLAINED)
    console.note(
        f"candidates: no response ≥ {limits.no_response:g}, turned ≥ {limits.turned:g}, or width ≥ "
        f"{limits.width:g}"
    )
    for left in found.left_out:
        console.note(f"{left.scenario}: left out: {left.why}")
    for note in found.notes:
        console.note(note)


def _fields(one: Listed) -> tuple[str, ...]:
    shares = (one.no_response, one.turned, one.width, one.priority)
    return (
        "–" if one.rank is None else str(one.rank), one.scenario, one.event_version[:19],
        *(f"{share:.2f}" for share in shares), "; ".join(one.reasons) or "no candidate",
    )  # fmt: skip
