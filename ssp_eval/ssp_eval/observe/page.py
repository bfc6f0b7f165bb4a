"""The observer's page: the frames beside a form, in one file that needs no network."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from markupsafe import Markup

from ssp_eval.observe.frames import Shown
from ssp_eval.observe.questions import Card
from ssp_eval.templates import templates

_HERE = Path(__file__).parent


def render(
    draft: dict[str, Any], questions: Sequence[Card], frames: Sequence[Shown], bag: str
) -> str:
    """The page.

    Args:
        draft: the file without any answer.
        questions: what is asked.
        frames: what is shown.
        bag: as it is named on the command line.
    """
    data = {
        "draft": draft,
        "cards": [asdict(card) for card in questions],
        "bag": bag,
        "frames": [
            {
                "n": frame.index,
                "t": round(frame.t_s, 6),
                "src": f"data:image/jpeg;base64,{b64encode(frame.jpeg).decode()}",
            }
            for frame in frames
        ],
    }
    return (
        templates(_HERE)
        .get_template("page.html.j2")
        .render(
            recording=draft["recording"],
            digest=draft["bag_sha256"],
            style=Markup((_HERE / "page.css").read_text()),
            script=Markup((_HERE / "page.js").read_text()),
            # No markup may end the script that holds it.
            data=Markup(json.dumps(data).replace("<", "\\u003c")),
        )
    )
