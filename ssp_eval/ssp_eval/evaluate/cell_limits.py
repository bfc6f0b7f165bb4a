"""What keeps the files of a cell so small that their readers take them.

A cell can have thousands of label times, and a bridge may say a megabyte about each answer. All of
it stands in ``requests.jsonl`` and ``raw.jsonl``; ``cell.json`` sums it up.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ssp_core.files import MAX_TEXT_BYTES, write_text
from ssp_eval.evaluate.asker import MOST_REASON
from ssp_vla_bridge.messages import Response

# In decoding facts these tell of one answer, not of how a model was set.
_PER_ANSWER = (
    "stages", "usage", "latency_s", "notes", "frames", "prompt_sha256", "previous_intent_sha256",
)  # fmt: skip
# Settings are a few lines; what is far more must be about the single answers.
_MOST_DECODING = 1 << 20
_MOST_REASONS = 20
DIFFERING = "differs_by_answer"


def write_readable(path: Path, value: Any) -> bool:
    """Writes indented JSON with sorted keys, without spaces where it would be too large to be read.

    Returns:
        False where it is too large even so; nothing is written then.
    """
    for style in ({"indent": 1}, {"separators": (",", ":")}):
        text = json.dumps(value, sort_keys=True, allow_nan=False, **style) + "\n"
        if len(text.encode()) <= MAX_TEXT_BYTES:
            write_text(path, text)
            return True
    return False


def too_large(name: str, value: Mapping[str, Any]) -> str:
    """The reason why a cell whose file can't be read is failed.

    Args:
        name: of the file.
        value: that it would hold.
    """
    sizes = {key: len(json.dumps(part)) for key, part in value.items()}
    largest = max(sizes, key=lambda key: sizes[key])
    return (
        f"{name} would be larger than the {MAX_TEXT_BYTES >> 20} MiB that are read: {largest} "
        f"alone has {sizes[largest] / (1 << 20):.1f} MiB"
    )


def short(reason: str) -> str:
    """A reason of a length that people read."""
    return reason if len(reason) <= MOST_REASON else reason[: MOST_REASON - 1] + "…"


def short_list(reasons: Sequence[str]) -> list[str]:
    """The first reasons, and how many more there are."""
    more = len(reasons) - _MOST_REASONS
    shown = [short(reason) for reason in reasons[:_MOST_REASONS]]
    return [*shown, f"and {more} more"] if more > 0 else shown


def decodings(answers: Sequence[Response]) -> list[dict[str, Any]]:
    """The different settings that answers were decoded with; what differs by answer is raw.

    Where that is more than settings can be, what all answers share, and the names of the rest.
    """
    found = {}
    for answer in answers:
        settings = {k: v for k, v in answer.decoding.items() if k not in _PER_ANSWER}
        found[json.dumps(settings, sort_keys=True)] = settings
    if sum(map(len, found)) <= _MOST_DECODING:
        return [found[key] for key in sorted(found)]
    texts = [{k: json.dumps(v, sort_keys=True) for k, v in one.items()} for one in found.values()]
    same = {
        key: value
        for key, value in texts[0].items()
        if len(value) <= _MOST_DECODING and all(one.get(key) == value for one in texts)
    }
    names = sorted({short(key) for one in texts for key in one if key not in same})
    shared: dict[str, Any] = {key: json.loads(value) for key, value in same.items()}
    return [{**shared, DIFFERING: short_list(names)}]
