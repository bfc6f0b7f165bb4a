"""The one way in which pages and drawings are made of templates."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import jinja2
from markupsafe import Markup


@cache
def templates(*folders: Path) -> jinja2.Environment:
    """Return the templates of some folders, which escape and refuse a value that they aren't given.

    Of two with one name that of the first folder counts. All pages of a process share them, since
    compiling a template takes longer than filling it in.

    Filters: ``svg`` takes markup as it is, ``words`` turns a name into words, ``short`` shortens a
    hash, ``json`` writes a value as JSON, ``g`` a number with six digits at most.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(folders),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["svg"] = Markup
    environment.filters["words"] = lambda text: str(text).replace("_", " ")
    environment.filters["short"] = lambda digest: str(digest).removeprefix("sha256:")[:12]
    environment.filters["json"] = lambda value: json.dumps(value, sort_keys=True)
    environment.filters["g"] = lambda value: f"{value:g}"
    return environment
