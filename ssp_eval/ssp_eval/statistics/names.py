"""Names of models and scenarios that don't say what they seem to: doubled ones, means, controls."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Mapping, Sequence

from ssp_eval.evaluate.clients.models import ANSWERERS, BEST_CONSTANT, CONTROLS, is_control_name
from ssp_eval.statistics.table import some

# All that may stand between the parts of a name: spaces, underscores, dashes of any length.
_BETWEEN = re.compile(r"[\s_\-‐-―−\u00ad\u200b-\u200d\ufeff]+")
_NO_LETTER = re.compile(r"[\W\d_]+")
# A name with one of these words is that of a mean, whatever stands beside it.
_MEAN_WORDS = frozenset(
    {"mean", "means", "average", "averages", "averaged", "avg", "avgs", "overall", "macro", "ø"}
    | {"macroaverage", "macroaverages", "macroavg", "macromean", "moyenne", "promedio"}
    | {"mittel", "mittelwert", "durchschnitt", "gesamt", "gesamtmittel", "gesamtmittelwert"}
)
# These also stand in names of scenarios and models, such as the median of a road; with one of them
# a name is a mean's if it holds nothing else but what stands beside such words.
_TOTAL_WORDS = frozenset({"total", "all", "aggregate", "aggregated", "median", "medians"})
_BESIDE = frozenset(
    {"of", "over", "the", "models", "scenarios", "domains", "cells", "events", "score", "scores"}
    | {"model", "scenario", "domain", "cell", "event", "result", "results", "performance", "n"}
    | {"weighted", "unweighted", "micro", "grand", "std", "sd", "ci", "row", "rows"}
)
_METRICS = frozenset({"ivcs", "jovr", "cia", "tqsr", "stfr", "rsr", "rl", "atc", "acc", "eff"})
_HUMP = re.compile(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
_KINDS = (("scenario", "scenarios"), ("model", "models"))


def folded(name: str) -> str:
    """Return a name without case, spaces, underscores and dashes."""
    return _BETWEEN.sub("", unicodedata.normalize("NFKC", name).casefold())


def is_mean_name(name: str) -> bool:
    """Return whether a name is that of a mean over others: ``Average``, ``mean of 5 models``."""
    plain = unicodedata.normalize("NFKC", name)
    words = _words(plain)
    totals = words & _TOTAL_WORDS
    if words & _MEAN_WORDS or (totals and words <= _TOTAL_WORDS | _BESIDE):
        return True
    # MeanIVCS, AvgScore; but MeanFlow is a model.
    humps = _words(_HUMP.sub(" ", plain))
    mean_words = humps & (_MEAN_WORDS | _TOTAL_WORDS)
    return bool(mean_words) and humps <= _MEAN_WORDS | _TOTAL_WORDS | _BESIDE | _METRICS


def _words(name: str) -> set[str]:
    return {word for word in _NO_LETTER.split(name.casefold()) if word}


def doubtful_names(names: Mapping[str, Iterable[str]]) -> list[tuple[str, tuple[str, ...]]]:
    """Find names that a reader of means must know of.

    Args:
        names: those of scenarios and of models that enter means, under ``scenario`` and ``model``.

    Returns:
        Sentences, each with the names that it is about.
    """
    doubts = []
    for key, many in _KINDS:
        alike: dict[str, list[str]] = {}
        for name in sorted(set(names.get(key, ()))):
            alike.setdefault(folded(name), []).append(name)
        for group in alike.values():
            if len(group) > 1:
                text = (
                    f"Names of {many} that differ in case, dashes or spaces only: "
                    f"{some(group, ' and ')}. They count as {len(group)} {many}; if they are one, "
                    "write its name alike everywhere."
                )
                doubts.append((text, tuple(group)))
        if means := [name for group in alike.values() for name in group if is_mean_name(name)]:
            text = (
                f"Named like a mean, and counted as a {key} like any other: {some(sorted(means))}. "
                "A mean over scenarios or domains has the scenario or domain macro; a mean over "
                "models has to be left out."
            )
            doubts.append((text, tuple(sorted(means))))
    return doubts


def control_names(models: Sequence[str]) -> list[str]:
    """Name the models that aren't declared controls and have a control's name, or nearly.

    Args:
        models: names of rows that don't say whether they are controls.
    """
    own = {folded(name): name for name in (*CONTROLS, *ANSWERERS, BEST_CONSTANT)}
    names = sorted(set(models))
    clashes = [name for name in names if is_control_name(name)]
    answering = [name for name in names if name in ANSWERERS and name not in clashes]
    nearly = {
        name: control_name
        for name in names
        if name not in (*own.values(), *clashes) and (control_name := _control_written(name, own))
    }
    remarks = []
    if clashes:
        remarks.append(
            f"by {'its name a control' if len(clashes) == 1 else 'their names controls'} of the "
            f"harness, which enter no mean: {some(clashes)}. A model needs another name."
        )
    if answering:
        remarks.append(
            f"answerers of the harness that see nothing, ranked like models: {some(answering)}. "
            "A column control with yes in their lines keeps them out; a model needs another name."
        )
    if nearly:
        remarks.append(
            f"ranked as models, with a control's name but for case, dashes or spaces: "
            f"{some([*nearly])}. A control is written {some([*dict.fromkeys(nearly.values())])}; a "
            "model needs another name."
        )
    return remarks


def _control_written(name: str, own: Mapping[str, str]) -> str:
    """Return how a control of this name, but for case, dashes and spaces, is written; else empty.

    Args:
        name: of a row.
        own: names of controls that are no model under a condition, by the folded ones.
    """
    base, _, condition = name.rpartition("+")
    spelling = f"{base.strip()}+{folded(condition)}"
    return own.get(folded(name)) or (spelling if is_control_name(spelling) else "")
