"""An observation to be filled in with a text editor: YAML that says what may stand where."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import Any

from ssp_eval.observe.questions import Ask, Card, blank, cards
from ssp_eval.recordings.observation import SCHEMA

_HEAD = """\
# What you saw in this recording (METHOD 4.3). Look at the recording alone: not at the event's
# specification, and not at somebody else's observation.
#
# null means that you can't tell; the field is then unverified. "frames" are the frames that show
# the answer: numbers from 0 to {last}, or [first, last]. Every answer needs some.
# Frame n lies at about {first_s:.3f} s + n × {period_s:.4f} s. Times are clip times, s.
#
# Then: ssp audit observe {bag} --seal THIS_FILE
"""


def template(
    bag: str,
    about: dict[str, Any],
    vut: str,
    targets: Sequence[str],
    has_log: bool,
    frames_s: Sequence[float],
    period_s: float,
) -> str:
    """The text of the file.

    Args:
        bag: as it is named on the command line.
        about: recording, bag_sha256, scenario and event_version.
        vut: id of the VUT.
        targets: ids of the OTs.
        has_log: see cards.
        frames_s: clip times of the frames.
        period_s: between them.
    """
    questions = cards(vut, targets, has_log)
    groups = {card.path: card for card in questions if card.path}
    asks = {ask.path: (card, ask) for card in questions for ask in card.asks}
    head = _HEAD.format(bag=bag, last=len(frames_s) - 1, first_s=frames_s[0], period_s=period_s)
    lines = [f"schema: {SCHEMA}"]
    lines += [f"{key}: {_scalar(value)}" for key, value in about.items()]
    lines += [
        "who: null  # your name",
        "role: null",
        "when: null  # null: when it is sealed",
        "remark: null",
    ]
    for key, value in blank(vut, targets, has_log).items():
        lines += ["", *_lines(key, value, key, 0, groups, asks)]
    return head + "\n".join(lines) + "\n"


def _lines(
    key: str,
    value: Any,
    path: str,
    depth: int,
    groups: dict[str, Card],
    asks: dict[str, tuple[Card, Ask]],
) -> Iterator[str]:
    pad = "  " * depth
    if path in groups:
        card = groups[path]
        yield from (f"{pad}# {line}" for line in (card.title, card.help) if line)
    if isinstance(value, dict):
        yield f"{pad}{key}:"
        for name, item in value.items():
            yield from _lines(name, item, f"{path}.{name}", depth + 1, groups, asks)
        return
    comment = _comment(asks[path][1]) if path in asks else ""
    yield f"{pad}{key}: {_scalar(value)}" + (f"  # {comment}" if comment else "")


def _comment(ask: Ask) -> str:
    if ask.kind == "share":
        return "throughout | never | a share from 0 to 1"
    if ask.kind == "time":
        return "s"
    if ask.kind == "lines":
        return "a list of texts; [] for nothing"
    return " | ".join(_scalar(value) for value, _ in ask.words)


def _scalar(value: Any) -> str:
    """JSON, but words without quotes."""
    plain = isinstance(value, str) and value.replace("_", "").replace(" ", "").isalnum()
    # A word that begins with a digit stays text where YAML would look for a number.
    if plain and not value[0].isdigit():
        return str(value)
    return json.dumps(value)
