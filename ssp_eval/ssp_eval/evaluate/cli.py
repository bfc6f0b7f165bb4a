"""``ssp evaluate``: bags through bridges to scored cells."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import click

from ssp_core import console
from ssp_core.errors import InputError
from ssp_core.files.reading import read_json_mapping
from ssp_core.options import Number, WholeNumber
from ssp_eval.evaluate.clients.models import (
    ANSWERERS,
    PICTURES,
    ModelSpec,
    attached_spec,
    bridge_spec,
    check_bridge,
    load_models,
)
from ssp_eval.evaluate.clients.topic_client import CONNECT_S
from ssp_eval.evaluate.conditions.expansion import (
    is_chat,
    with_blind,
    with_controls,
    with_pictures,
    with_reasoning,
)
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.executors import Settings
from ssp_eval.evaluate.run import (
    ENGINES,
    asking,
    evaluate_bags,
    interrupt_notice,
    result_to_json,
    run_parallel,
    show,
)
from ssp_eval.evaluate.store.admission import load_admissions
from ssp_eval.evaluate.store.cell_file import CELL_FILE, CELLS
from ssp_eval.extract.combined.options import extractor_of, llm_options
from ssp_eval.score.thresholds import OTHER_THRESHOLDS, changes, load_thresholds, thresholds_option


def model_specs(
    bridges: Sequence[str], attached: Sequence[str], files: Sequence[Path] = ()
) -> list[ModelSpec]:
    """Return the models of a campaign, without controls.

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
    for name, count in Counter(model.result_name for model in models).items():
        if count > 1:
            raise click.UsageError(f"model {name} stands {count} times")
    for model in models:
        if not model.attached:
            check_bridge(model)
    return models


def blinded(models: Sequence[ModelSpec]) -> list[ModelSpec]:
    """Return the models, and those that can be asked without pictures once more so.

    Raises:
        click.UsageError: none can.
    """
    if not any(map(is_chat, models)):
        raise click.UsageError(
            "--blind: no model can be asked without pictures; that needs the backend openai"
        )
    return with_blind(models)


def reasoned(models: Sequence[ModelSpec]) -> list[ModelSpec]:
    """Return the models, and again those that take back their own text; tell which don't.

    Raises:
        click.UsageError: none can.
    """
    candidates = [model for model in models if not model.condition and not model.answerer]
    if not any(map(is_chat, candidates)):
        raise click.UsageError(
            "--reasoning: no model can be given its own text back; that needs the backend openai"
        )
    for model in candidates:
        if not is_chat(model):
            console.note(f"reasoning of {model.name}: n/a, its bridge gives no text back")
    return with_reasoning(models)


def driving_before(out: Path) -> set[str]:
    """Return answerers that somebody named as a model in an earlier command into the same folder.

    As controls they would leave the means that they are in.

    Args:
        out: campaign folder; it need not be there.
    """
    return {name for name in ANSWERERS if any(map(_drives, out.glob(f"{CELLS}/*__{name}")))}


def _drives(cell: Path) -> bool:
    try:
        return not read_json_mapping(cell / CELL_FILE).get("control", False)
    except InputError:
        return False


_PATH = click.Path(path_type=Path)


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
@click.option("--propose-labels", is_flag=True, help="Propose labels where there are none.")
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
    help='Model whose bridge is already running: NAME, or NAME={"interface": …, "adapter": …}.',
)
@click.option(
    "--models",
    "models_files",
    type=_PATH,
    multiple=True,
    help="Models file (ssp.models/1), YAML; see docs/bridges.md.",
)
@click.option(
    "--out", type=_PATH, required=True, help="Campaign folder; an existing one is resumed."
)
@click.option(
    "--adapter", default="", help="Adapter that reads all answers; default: each model's own."
)
@click.option(
    "--timeout",
    "timeout_s",
    type=Number(0.1, 86400.0),
    default=60.0,
    show_default=True,
    help="Time limit for one answer, s, unless a model has its own.",
)
@click.option(
    "--start-timeout",
    "start_timeout_s",
    type=Number(0.1, 86400.0),
    default=CONNECT_S,
    show_default=True,
    help="Time limit for a bridge to load its model and appear on its topics, s.",
)
@click.option(
    "--retry-errors",
    type=WholeNumber(0, 100),
    default=0,
    show_default=True,
    help="Number of repeats of a question after a timeout, an overload, or a bridge that died or "
    "can't be reached; other errors would recur.",
)
@thresholds_option
@llm_options("llm-")
@click.option("--fresh", is_flag=True, help="Ask again even where an answer is stored.")
@click.option(
    "--controls/--no-controls",
    default=True,
    show_default=True,
    help="Add the built-in baselines, and ask each model again with black and with shuffled "
    "frames (three times as many questions); controls enter no mean.",
)
@click.option(
    "--blind",
    is_flag=True,
    help="Ask each model of the backend openai again without pictures, to show what it scores "
    "from the words alone; enters no mean.",
)
@click.option(
    "--pictures",
    is_flag=True,
    help=f"Ask each model once more under {len(PICTURES)} corruptions of its frames: noise, "
    "blur, fog, low light, glare, lost frames, none to see, and encoded again; none enters a mean.",
)
@click.option(
    "--twins",
    is_flag=True,
    help="Ask each model and baseline again about each twin that `ssp twins` made beside a BAG, "
    "at the times of the BAG's labels; they enter no mean.",
)
@click.option(
    "--reasoning",
    is_flag=True,
    help="Give each model of the backend openai its own text back, unchanged and with its object, "
    "side or action reversed, and ask for the trajectory; enters no mean.",
)
@click.option(
    "--workers",
    type=WholeNumber(1, 1024),
    default=None,
    help="Number of cells evaluated at a time, each in its own process with its own bridges.",
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
    thresholds_file: Path | None,
    fresh: bool,
    controls: bool,
    blind: bool,
    pictures: bool,
    twins: bool,
    reasoning: bool,
    workers: int | None,
    engine: str,
    as_json: bool,
    **llm: Any,
) -> int:
    """Replay BAGS through VLA bridges and score the answers.

    Raw answers are stored in OUT before anything interprets them; stored ones aren't asked for
    again. Errors don't count as answers: the same command, given again, asks for them again, and
    for what an interruption left out. Recordings are looked up in the audits by the hash of their
    bag: a refused one isn't evaluated; one that is unpaired or in no audit is scored but left out
    of domain means. Controls are asked too, unless they are switched off; the number of questions
    is printed before the first one. Exit status 1 if a cell has no score, also after a refusal; a
    control that fails because of its condition doesn't count.
    """
    if labels_files and len(labels_files) != len(bags):
        raise click.UsageError(
            f"--labels is given {len(labels_files)} times for {len(bags)} bags; give it once per "
            "bag or not at all"
        )
    thresholds = load_thresholds(thresholds_file)
    models = model_specs(bridges, attached, models_files)
    if controls:
        models = with_controls(models, driving_before(out))
    if blind:
        models = blinded(models)
    if pictures:
        models = with_pictures(models)
    if reasoning:
        models = reasoned(models)
    paired: list[tuple[Path, Path | None]] = [(bag, None) for bag in bags]
    if labels_files:
        paired = list(zip(bags, labels_files, strict=True))
    make_extractor = partial(extractor_of, **llm, default_cache=out.absolute() / "extraction")
    options = CellOptions(
        adapter, fresh, retry_errors, extractor=make_extractor(), thresholds=thresholds
    )
    with interrupt_notice(out):
        if workers is None and engine == "processes":
            settings = Settings(out, make_extractor, options, timeout_s, start_timeout_s)
            results = evaluate_bags(
                paired, models, settings, propose_labels, load_admissions(audits), twins=twins
            )
        else:
            place = out.absolute()
            settings = Settings(place, make_extractor, options, timeout_s, start_timeout_s)
            with asking() as (on_plan, on_record):
                results = run_parallel(
                    paired,
                    models,
                    settings,
                    workers or os.cpu_count() or 1,
                    engine,
                    propose_labels,
                    load_admissions(audits),
                    on_plan=on_plan,
                    on_record=on_record,
                    twins=twins,
                )
    if changed := changes(thresholds):
        console.note(f"{OTHER_THRESHOLDS}: {changed}")
    if as_json:
        for result in results:
            click.echo(json.dumps(result_to_json(result), sort_keys=True))
    else:
        show(results, out)
    return 1 if any(result.is_failure for result in results) else 0
