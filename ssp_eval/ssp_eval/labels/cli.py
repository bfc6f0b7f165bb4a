"""``ssp labels``: propose a labels file, check one."""

from __future__ import annotations

import json
from pathlib import Path

import click

from ssp_core import console
from ssp_core.errors import InputError
from ssp_core.files import make_folder
from ssp_core.hashing import sha256_file
from ssp_core.vocab import DOMAINS
from ssp_eval.evaluate.truth import truth_from_bag, truth_from_file
from ssp_eval.labels.model import load_labels
from ssp_eval.labels.proposal_file import is_unreviewed, sidecar, write_proposal
from ssp_eval.labels.propose import ProposalRules, propose, response_problems

_PATH = click.Path(path_type=Path)


@click.group()
def labels() -> None:
    """Proposes and checks labels files (METHOD 5.2)."""


@labels.command()
@click.argument("bag", type=_PATH, required=False)
@click.option("--truth", type=_PATH, help="Truth file of a clip (ssp.truth/1), in place of a bag.")
@click.option("--out", type=_PATH, required=True, help="Labels file to write.")
@click.option("--domain", type=click.Choice(DOMAINS), help="Where it isn't the truth file's own.")
@click.option("--event-version", help="K* version, where the truth file names none.")
@click.option("--count", type=click.IntRange(1, 1000), default=9, show_default=True)
@click.option(
    "--spacing",
    type=click.FloatRange(0.1, 60.0),
    default=0.5,
    show_default=True,
    help="Seconds between labels.",
)
@click.option("--force", is_flag=True, help="Overwrite an existing file.")
def new(
    bag: Path | None,
    truth: Path | None,
    out: Path,
    domain: str | None,
    event_version: str | None,
    count: int,
    spacing: float,
    force: bool,
) -> None:
    """Proposes labels from the ground truth in BAG, or in a clip's truth file.

    A proposal is marked in a sidecar (FILE.proposal.json) until somebody edits the labels; results
    and reports say so.
    """
    if (bag is None) == (truth is None):
        raise click.UsageError("give either BAG or --truth FILE")
    if out.is_dir():
        raise InputError("is a folder", file=out, remedy="name a file with --out")
    if out.exists() and not force:
        raise InputError(
            "exists already", file=out, remedy="give --force to overwrite what may be reviewed"
        )
    if bag is not None:
        ground_truth = truth_from_bag(bag)
        source = str(bag)
    elif truth is not None:
        ground_truth = truth_from_file(truth, domain, event_version)
        source = sha256_file(truth)
    make_folder(out.parent)
    proposal = propose(ground_truth, ProposalRules(count=count, spacing_s=spacing))
    write_proposal(out, proposal, source)
    event = proposal.event
    end = "not within the clip" if event.resolution_s is None else f"{event.resolution_s:.2f} s"
    console.note(
        f"{out}: {len(proposal.labels.labels)} labels; trigger {event.trigger_s:.2f} s, conflict "
        f"{event.conflict_s:.2f} s, resolution {end}. Look them over: they are a proposal."
    )
    for problem in response_problems(proposal.labels):
        console.note(f"warning: no model can get a risk response: {problem}")


@labels.command()
@click.argument("file", type=_PATH)
@click.option("--json", "as_json", is_flag=True, help="For programs.")
def check(file: Path, as_json: bool) -> None:
    """Checks FILE after METHOD 5.2, and warns when no risk response could be reached."""
    loaded = load_labels(file)
    problems = response_problems(loaded)
    unreviewed = is_unreviewed(file)
    if as_json:
        value = {
            "file": str(file),
            "scenario": loaded.scenario,
            "domain": loaded.domain,
            "labels": len(loaded.labels),
            "risk_onset_s": loaded.risk_onset_s,
            "unreviewed": unreviewed,
            "warnings": problems,
        }
        click.echo(json.dumps(value, sort_keys=True))
        return
    click.echo(
        f"{file}: {loaded.scenario} in {loaded.domain}, {len(loaded.labels)} labels, risk from "
        f"{loaded.risk_onset_s:g} s"
    )
    if unreviewed:
        console.note(f"note: as proposed and not reviewed ({sidecar(file).name})")
    for problem in problems:
        console.note(f"warning: no model can get a risk response: {problem}")
