"""``ssp evaluate``: bags through bridges to scored cells."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import click
from rich.table import Table

from ssp_core import console
from ssp_eval.evaluate.admission import (
    ADMITTED,
    REFUSED,
    UNAUDITED,
    Admission,
    load_admissions,
)
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.cell import CellOptions
from ssp_eval.evaluate.cell_file import CellResult, losses_text
from ssp_eval.evaluate.job import Settings
from ssp_eval.evaluate.model_spec import ModelSpec
from ssp_eval.evaluate.models import (
    attached_spec,
    bridge_spec,
    check_bridge,
    load_models,
    with_controls,
)
from ssp_eval.evaluate.parallel import ENGINES, run_parallel
from ssp_eval.evaluate.topic_asker import CONNECT_S
from ssp_eval.evaluate.topics import TopicAskers
from ssp_eval.extract.llm.options import extractor_of, llm_options

_PATH = click.Path(path_type=Path)
_WIDEST = 400
# Shown at the end; METHOD 6.14 has all of them.
_COLUMNS = (("JOVR", "jovr"), ("Sem", "sem_acc_eff"), ("CIA", "cia_eff"), ("TQSR", "tqsr"))


@click.command()
@click.argument("bags", type=_PATH, nargs=-1, required=True)
@click.option(
    "--labels",
    "labels_files",
    type=_PATH,
    multiple=True,
    help="Labels file, once per BAG in the same order. Default: beside each bag.",
)
@click.option(
    "--audit",
    "audits",
    type=_PATH,
    multiple=True,
    help="Audit (audit.json or its folder); repeatable. What it refused isn't evaluated.",
)
@click.option("--propose-labels", is_flag=True, help="Where there are none, propose them.")
@click.option(
    "--bridge",
    "bridges",
    multiple=True,
    help='Model whose bridge is started here: NAME, or NAME={"backend": …, "adapter": …, '
    '"timeout_s": …} with the backend\'s options beside these. Default backend: NAME.',
)
@click.option(
    "--attach",
    "attached",
    multiple=True,
    help='Model whose bridge runs already: NAME, or NAME={"interface": …, "adapter": …}.',
)
@click.option(
    "--models",
    "models_files",
    type=_PATH,
    multiple=True,
    help="Models file (ssp.models/1), YAML; see docs/bridges.md.",
)
@click.option("--out", type=_PATH, required=True, help="Campaign folder; an existing one goes on.")
@click.option("--adapter", default="", help="Reads all answers; default: each model's own.")
@click.option(
    "--timeout",
    "timeout_s",
    type=click.FloatRange(0.1, 86400.0),
    default=60.0,
    show_default=True,
    help="Seconds that a model has for one answer, unless it has a time of its own.",
)
@click.option(
    "--start-timeout",
    "start_timeout_s",
    type=click.FloatRange(0.1, 86400.0),
    default=CONNECT_S,
    show_default=True,
    help="Seconds until a bridge is on its topics, which is after it has loaded its model.",
)
@click.option(
    "--retry-errors",
    type=click.IntRange(0, 100),
    default=0,
    show_default=True,
    help="How often a question is repeated after a timeout, an overload or a bridge that died or "
    "can't be reached; other errors would come again.",
)
@llm_options("llm-")
@click.option("--fresh", is_flag=True, help="Ask again even where an answer is stored.")
@click.option(
    "--controls",
    is_flag=True,
    help="Add the harness's own answerers, and each model once more with black and with shuffled "
    "frames; none of them enters a mean.",
)
@click.option(
    "--workers",
    type=click.IntRange(1, 1024),
    default=None,
    help="Evaluate that many cells at a time, each in a process with bridges of its own.",
)
@click.option(
    "--engine",
    type=click.Choice(tuple(ENGINES)),
    default="processes",
    show_default=True,
    help="Where workers run: on this machine, or on the Ray cluster that RAY_ADDRESS names "
    "(without one, a local one is started).",
)
@click.option("--json", "as_json", is_flag=True, help="One line per cell, for programs.")
def evaluate(
    bags: tuple[Path, ...],
    labels_files: tuple[Path, ...],
    audits: tuple[Path, ...],
    propose_labels: bool,
    bridges: tuple[str, ...],
    attached: tuple[str, ...],
    models_files: tuple[Path, ...],
    out: Path,
    adapter: str,
    timeout_s: float,
    start_timeout_s: float,
    retry_errors: int,
    fresh: bool,
    controls: bool,
    workers: int | None,
    engine: str,
    as_json: bool,
    **llm: Any,
) -> int:
    """Replays BAGS through VLA bridges and scores the answers.

    Raw answers are stored in OUT before anything interprets them; asking is not repeated for what
    is stored. Errors don't count as answers: the same command, given again, asks for them again,
    and for what an interruption left out. Recordings are looked up in the audits by the hash of
    their bag: a refused one isn't evaluated, one that is unpaired or in no audit is scored and
    stays out of domain means. Exit status 1 when some cell has no score, be it for a refusal.
    """
    if labels_files and len(labels_files) != len(bags):
        raise click.UsageError(
            f"--labels is given {len(labels_files)} times for {len(bags)} bags; give it once per "
            "bag or not at all"
        )
    models = model_specs(bridges, attached, models_files)
    if controls:
        models = with_controls(models)
    paired: list[tuple[Path, Path | None]] = [(bag, None) for bag in bags]
    if labels_files:
        paired = list(zip(bags, labels_files, strict=True))
    make_extractor = partial(extractor_of, **llm, default_cache=out.absolute() / "extraction")
    extractor = make_extractor()
    if workers is None and engine == "processes":
        results = evaluate_bags(
            paired,
            models,
            out,
            CellOptions(adapter, fresh, retry_errors, extractor=extractor),
            timeout_s,
            propose_labels,
            load_admissions(audits),
            start_timeout_s,
        )
    else:
        settings = Settings(
            out=out.absolute(),
            make_extractor=make_extractor,
            adapter=adapter,
            fresh=fresh,
            retry_errors=retry_errors,
            timeout_s=timeout_s,
            start_timeout_s=start_timeout_s,
        )
        with console.progress("asking", None) as bar:
            task = bar.task_ids[0]
            results = run_parallel(
                paired,
                models,
                settings,
                workers or os.cpu_count() or 1,
                engine,
                propose_labels,
                load_admissions(audits),
                on_total=lambda total: bar.update(task, total=total),
                on_record=lambda: bar.advance(task),
            )
    if as_json:
        for result in results:
            click.echo(json.dumps(_to_json(result), sort_keys=True))
    else:
        show(results, out)
    return 0 if all(result.status == "ok" for result in results) else 1


def model_specs(
    bridges: Sequence[str], attached: Sequence[str], files: Sequence[Path] = ()
) -> list[ModelSpec]:
    """The models of a campaign.

    Raises:
        click.UsageError: there are none, one stands twice, or some are attached and others not.
        InputError: there is no such bridge, or its options are wrong.
    """
    models = [model for file in files for model in load_models(file)]
    models += [bridge_spec(text) for text in bridges]
    models += [attached_spec(text) for text in attached]
    if len({model.attached for model in models}) > 1:
        raise click.UsageError(
            "bridges that are started here are in a ROS domain of their own, attached ones in "
            "yours; run twice into the same --out"
        )
    if not models:
        raise click.UsageError("name a model: --bridge NAME, --attach NAME or --models FILE")
    for name, count in Counter(model.name for model in models).items():
        if count > 1:
            raise click.UsageError(f"model {name} stands {count} times")
    for model in models:
        if not model.attached:
            check_bridge(model)
    return models


def evaluate_bags(
    bags: Sequence[tuple[Path, Path | None]],
    models: Sequence[ModelSpec],
    out: Path,
    options: CellOptions,
    timeout_s: float = 60.0,
    propose_labels: bool = False,
    admissions: Mapping[str, Admission] | None = None,
    start_timeout_s: float = CONNECT_S,
) -> list[CellResult]:
    """A campaign over topics with a progress bar; what the command line and the demo run.

    Args:
        bags: bag and its labels file (None: look beside it).
        models: who is asked.
        out: campaign folder.
        options: adapter, reuse and repetition.
        timeout_s: for one answer.
        propose_labels: where there are no labels, propose them.
        admissions: what audits say, by hash of the bag.
        start_timeout_s: until a bridge is on its topics.

    Raises:
        InputError: a bag, its labels or an option is wrong.
    """
    attached = any(model.attached for model in models)
    with (
        console.progress("asking", None) as bar,
        TopicAskers(out / "logs", timeout_s, attached, start_timeout_s) as askers,
    ):
        task = bar.task_ids[0]
        return run_campaign(
            bags,
            models,
            askers,
            out,
            options,
            propose_labels,
            admissions,
            on_total=lambda total: bar.update(task, total=total),
            on_record=lambda: bar.advance(task),
        )


def show(results: Sequence[CellResult], out: Path) -> None:
    """The table at the end of a campaign."""
    table = Table(box=None, pad_edge=False)
    for name in ("scenario", "domain", "model", "status", "audit"):
        table.add_column(name, no_wrap=True)
    for name in ("n", "missing", *(title for title, _ in _COLUMNS), "risk", "IVCS"):
        table.add_column(name, justify="right", no_wrap=True)
    for result in results:
        table.add_row(
            result.scenario,
            result.domain,
            result.model,
            result.status,
            result.admission,
            *_numbers(result),
        )
    # A narrow terminal or a pipe gets long lines rather than cut names.
    unbounded = console.out.options.update(max_width=_WIDEST)
    table.width = console.out.measure(table, options=unbounded).maximum
    console.out.print(table)
    for result in results:
        place = f"{result.scenario}/{result.domain}/{result.model}"
        if result.reasons:
            console.note(f"{place}: {result.status}: {'; '.join(result.reasons)}")
        elif result.missing:
            console.note(f"{place}: {losses_text(result.losses)} (see cell.json)")
        if result.admission == UNAUDITED and result.admission_reasons:
            why = "; ".join(result.admission_reasons)
            console.note(f"{place}: counts as unaudited, audit it again: {why}")
    outside = sorted({r.admission for r in results} - {ADMITTED, REFUSED})
    if outside:
        console.note(f"{' and '.join(outside)} recordings stay out of domain means")
    console.note(f"written to {out}; `ssp report {out}` makes a page of it")


def _numbers(result: CellResult) -> list[str]:
    score = result.score
    if score is None:
        return ["–"] * (len(_COLUMNS) + 4)
    cells = [f"{score['n']}", f"{result.missing or '·'}"]
    for _, key in _COLUMNS:
        cells.append("–" if score[key] is None else f"{score[key]:.2f}")
    risk = f"S@{score['rl_s']:.2f}" if score["rsr"] else "F"
    return [*cells, risk, f"{score['ivcs']:.3f}"]


def _to_json(result: CellResult) -> dict[str, Any]:
    return {
        "cell": result.folder.name,
        "scenario": result.scenario,
        "domain": result.domain,
        "model": result.model,
        "status": result.status,
        "admission": result.admission,
        "admission_reasons": list(result.admission_reasons),
        "reasons": list(result.reasons),
        "sent": result.asked,
        "reused": result.reused,
        "asked_again": result.again,
        "missing": result.missing,
        "missing_by_kind": dict(result.losses),
        "score": result.score,
    }
