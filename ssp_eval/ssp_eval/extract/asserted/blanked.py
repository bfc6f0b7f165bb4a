"""Blanks what a text names without asserting it: denied fields, options that weren't chosen.

What isn't asserted becomes spaces, so that spans keep their places and the rules read the rest as
it stands.
"""

from __future__ import annotations

from ssp_eval.extract.asserted.fields import conflicts, fields
from ssp_eval.extract.asserted.forms import bare_labels, boxes, questions, tokens, vectors
from ssp_eval.extract.asserted.labels import Values
from ssp_eval.extract.asserted.options import other_options
from ssp_eval.extract.asserted.unwanted import nested, preferences, set_aside


def asserted(text: str, values_of: Values) -> str:
    """Blank the parts of a text that it names without asserting them; the length stays.

    Args:
        text: a model's text.
        values_of: what the rules read in a piece of text: values by slot.
    """
    for step in (
        questions,
        preferences,
        set_aside,
        nested,
        vectors,
        conflicts,
        fields,
        boxes,
        tokens,
        other_options,
        bare_labels,
    ):
        for start, replacement in list(step(text, values_of)):
            text = text[:start] + replacement + text[start + len(replacement) :]
    return text
