"""The models of a campaign, each followed by itself under the conditions that it is asked under."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import groupby, zip_longest

from ssp_eval.evaluate.clients.models import (
    ANSWERERS,
    BLIND,
    CHAT,
    CONDITIONS,
    CONTROLS,
    FAMILIES,
    PICTURES,
    REASONING,
    REPEAT,
    ModelSpec,
    bridge_spec,
)
from ssp_vla_bridge.backend import NO_IMAGES
from ssp_vla_bridge.backends.given_back import FACTS


def with_controls(specs: list[ModelSpec], driving: Collection[str] = ()) -> list[ModelSpec]:
    """Return the models, each followed by itself under every condition, and our own answerers.

    Models that check the harness already get no conditions: they look at no frame, or repeat what
    was said about others. None is added that is there under its name.

    Args:
        specs: the campaign's models.
        driving: names under which the campaign has models already; an answerer with one of them is
            asked like the others and stays a model.
    """
    models = once_more(specs, CONDITIONS, {*CONTROLS, *ANSWERERS})
    names = {spec.name for spec in specs}
    added = [bridge_spec(name) for name in ANSWERERS if name not in names]
    return models + [replace(s, control=s.name not in driving, answerer=True) for s in added]


def with_pictures(specs: Sequence[ModelSpec]) -> list[ModelSpec]:
    """Return the models, each followed by itself under every corruption of the pictures.

    Models that check the harness get none, for the reasons of with_controls.
    """
    return once_more(specs, PICTURES, {*CONTROLS, *ANSWERERS})


def is_chat(spec: ModelSpec) -> bool:
    """Tell whether a bridge of ours writes the messages.

    Such a bridge can leave pictures out, and give a model its own text back.
    """
    return spec.backend_name == CHAT and not spec.attached


def with_blind(specs: Sequence[ModelSpec]) -> list[ModelSpec]:
    """Return the models, and behind them each one of the chat backend asked without pictures.

    A model that has its blind self already gets no second one.
    """
    there = {spec.name for spec in specs if spec.condition == BLIND}
    seeing = [s for s in specs if is_chat(s) and not s.condition and s.name not in there]
    return [
        *specs,
        *(
            replace(s, options={**s.options, "images": NO_IMAGES}, condition=BLIND, control=True)
            for s in seeing
        ),
    ]


def with_reasoning(specs: Sequence[ModelSpec]) -> list[ModelSpec]:
    """Return the models; one that takes its own text back is followed by itself with each fact."""
    names = [REASONING + fact for fact in FACTS]
    models = once_more(specs, names, {s.backend_name for s in specs if not is_chat(s)})
    return [
        replace(s, options={**s.options, "give_back": s.condition.removeprefix(REASONING)})
        if s.condition in names
        else s
        for s in models
    ]


def with_twin_conditions(specs: Sequence[ModelSpec], twins: Sequence[str]) -> list[ModelSpec]:
    """Return the models, each followed by itself under the twins of one recording.

    Answerers of ours that see no frame are asked too: what they say must not move but with the ego
    history. One that answers from labels, from a file or not at all isn't.

    Args:
        specs: the campaign's models.
        twins: their conditions.
    """
    return once_more(specs, twins, CONTROLS)


def with_repeats(specs: Sequence[ModelSpec]) -> list[ModelSpec]:
    """Return the models; one asked with a changed cause is followed by itself, asked again."""
    models: list[ModelSpec] = []
    for _, group in groupby(specs, lambda spec: spec.name):
        own, *others = group
        models += [own, *others]
        if any(spec.condition.startswith(FAMILIES) for spec in others):
            models.append(replace(own, condition=REPEAT, control=True))
    return models


def once_more(
    specs: Sequence[ModelSpec], conditions: Sequence[str], but: Collection[str]
) -> list[ModelSpec]:
    """Return the models, each followed by itself under conditions, behind those it already has.

    A blind model gets none, since no picture reaches it, and stands behind all others.

    Args:
        specs: models; the entries of one name stand together.
        conditions: their names.
        but: names of backends whose models get none.
    """
    models = []
    own = None
    blind = [spec for spec in specs if spec.condition == BLIND]
    specs = [spec for spec in specs if spec.condition != BLIND]
    for spec, following in zip_longest(specs, specs[1:]):
        models.append(spec)
        own = spec if own is None or own.name != spec.name else own
        last = following is None or following.name != spec.name
        if last and spec.backend_name not in but:
            models += [replace(own, condition=name, control=True) for name in conditions]
    return models + blind
