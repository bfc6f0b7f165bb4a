"""The models that a command names or named before, checked before anything is asked."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import click

from ssp_eval.evaluate.cell_file import CELL_FILE, CELLS
from ssp_eval.evaluate.controls import ANSWERERS
from ssp_eval.evaluate.model_spec import ModelSpec
from ssp_eval.evaluate.models import attached_spec, bridge_spec, check_bridge, load_models


def model_specs(
    bridges: Sequence[str], attached: Sequence[str], files: Sequence[Path] = ()
) -> list[ModelSpec]:
    """The models of a campaign, without controls.

    Args:
        bridges: as ``--bridge`` takes them.
        attached: as ``--attach`` takes them.
        files: models files.

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


def driving_before(out: Path) -> set[str]:
    """Answerers that somebody named as a model in an earlier command into the same folder.

    As controls they would leave the means that they are in.

    Args:
        out: campaign folder; it need not be there.
    """
    return {name for name in ANSWERERS if any(map(_drives, out.glob(f"{CELLS}/*__{name}")))}


def _drives(cell: Path) -> bool:
    try:
        told = json.loads((cell / CELL_FILE).read_bytes())
    except (OSError, ValueError):
        return False
    return isinstance(told, dict) and not told.get("control", False)
