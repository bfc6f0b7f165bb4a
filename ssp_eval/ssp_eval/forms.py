"""The pages on which a person answers questions: one HTML file each, which works offline.

What they share stands beside this module: the page (forms.html.j2), its look (forms.css), and what
every form does with its data, the browser's memory and files (forms.js).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup

from ssp_core.templates import templates

_SHARED = Path(__file__)


def form_page(template: Path, data: Mapping[str, Any], **values: Any) -> str:
    """Return a form as one HTML file without references to others.

    Args:
        template: extends forms.html.j2; sheet and script of the same name lie beside it.
        data: what the script finds in ``DATA``.
        values: of the template.
    """
    own = template.with_name(template.name.removesuffix(".html.j2"))
    return (
        templates(template.parent, _SHARED.parent)
        .get_template(template.name)
        .render(
            style=_both(".css", own),
            script=_both(".js", own),
            # No markup may end the script that holds it.
            data=Markup(json.dumps(data).replace("<", "\\u003c")),
            **values,
        )
    )


def _both(suffix: str, own: Path) -> Markup:
    return Markup("".join(path.with_suffix(suffix).read_text("utf-8") for path in (_SHARED, own)))
