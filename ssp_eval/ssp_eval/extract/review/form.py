"""The form for reviewers: one file that works offline."""

from __future__ import annotations

import random
from collections.abc import Mapping
from pathlib import Path

from ssp_core.files.folders import make_folder, taken_folder
from ssp_core.files.writing import write_json, write_text
from ssp_eval.data.records import SLOT_NAMES, VOCABULARIES
from ssp_eval.extract.conventions import ASKED, CONVENTIONS, GENERAL, REVIEWERS_TOO
from ssp_eval.extract.measure import NOBODY
from ssp_eval.extract.review.answers import ANSWERS_SCHEMA, NONE, REVIEWERS, UNSURE
from ssp_eval.extract.review.subset import Subset
from ssp_eval.forms import form_page

_TEMPLATE = Path(__file__).with_name("form.html.j2")


def write_review(subset: Subset, out: Path) -> None:
    """Write a folder per reviewer, and the key beside them, which is not for reviewers.

    Raises:
        InputError: there is something in the folder already, or it can't be made.
    """
    with taken_folder(out, empty=True):
        for reviewer in REVIEWERS:
            folder = make_folder(out / f"reviewer_{reviewer}")
            page = form(_order(subset, reviewer), subset.key.subset, reviewer)
            write_text(folder / "form.html", page)
        write_json(out / "key.json", subset.key.model_dump(mode="json", by_alias=True))


def form(texts: Mapping[str, str], subset: str, reviewer: int) -> str:
    """Return the form as one HTML file without references to others.

    Args:
        texts: by review id, in the order in which they are shown.
        subset: hash of the subset.
        reviewer: number.
    """
    slots = [
        {
            "name": name,
            "title": ASKED[name],
            "rule": CONVENTIONS[name],
            "several": name == "objects",
            "values": [*VOCABULARIES[name], *([NOBODY] if name == "objects" else [])],
        }
        for name in SLOT_NAMES
    ]
    data = {
        "schema": ANSWERS_SCHEMA,
        "subset": subset,
        "reviewer": reviewer,
        "slots": slots,
        "texts": [{"id": key, "text": _encodable_text(text)} for key, text in texts.items()],
        "alone": [NOBODY, NONE, UNSURE],
        "none": NONE,
        "unsure": UNSURE,
    }
    return form_page(
        _TEMPLATE, data, reviewer=reviewer, count=len(texts), general=(*GENERAL, REVIEWERS_TOO)
    )


def _order(subset: Subset, reviewer: int) -> dict[str, str]:
    """Return the texts in an order of the reviewer's own, so that fatigue meets different texts."""
    keys = list(subset.texts)
    random.Random(f"{subset.key.subset} {reviewer}").shuffle(keys)
    return {key: subset.texts[key] for key in keys}


def _encodable_text(text: str) -> str:
    return text.encode("utf-8", "replace").decode()
