"""Words for what is set aside: the lesser of two actions, rejected and earlier ones in fields."""

from __future__ import annotations

import re
from collections.abc import Iterator

from ssp_eval.extract.asserted.labels import Values

# "I'd rather brake than swerve"; of the VUT alone, so that "rather fast" is none.
_RATHER = re.compile(
    r"\b(?:I|we)(?P<would>['’]d| would)[ ]+(?:much )?(?P<word>rather|sooner)\b"
    r"[^.;:\n]{3,80}?\b(?P<than>than)\b",
    re.IGNORECASE,
)
# "I prefer braking over swerving", "braking is preferable to swerving", "better to brake than to".
_PREFERRED = re.compile(
    r"\b(?:prefer(?:s|red|ring)? (?!to\b)[^.,;:\n]{3,60}? (?P<over>over|to(?= \w+ing\b))"
    r"|preferable (?P<to>to)|(?:better|safer) to [^.,;:\n]{3,60}? (?P<than>than))\b",
    re.IGNORECASE,
)
_SET_ASIDE = (
    r"rejected|excluded|discarded|dismissed|forbidden|prohibited|disallowed|infeasible|unsafe"
    r"|previous|prev|last|past|earlier|alternatives?|fallback|back_?up|contingency|considered"
)
_ACTIONS = r"(?:actions?|man(?:o?eu|eu)vers?|manoeuvres?|decisions?|plans?|commands?|options?)"
_FIELD = re.compile(
    rf"[\"'](?:(?:{_SET_ASIDE})[_ ](?:\w+[_ ])?{_ACTIONS}|rejected|excluded|alternatives?"
    r"|(?:not_|un)(?:chosen|selected|taken)"
    r"|(?:action_)?history)[\"']\s*:\s*(?:\"[^\"\n]*\"|'[^'\n]*'|\[[^\[\]]*\]|\{[^{}]*\})\s*,?",
    re.IGNORECASE,
)
# {"motion": {"state": "cutting in", "from": "left"}}
_MOTION = re.compile(
    r"[\"'](?:motion|movement|behaviou?r|attributes|state)[\"']\s*:\s*(?P<object>\{[^{}\[\]]{5,200}\})",
    re.IGNORECASE,
)
_TEXT = re.compile(r"[\"'](?P<key>\w{2,20})[\"']\s*:\s*[\"'](?P<value>[^\"'\n]{1,40})[\"']")
_OF_MOTION = frozenset({"state", "type", "kind", "status", "motion", "movement", "action"})
_OF_SIDE = frozenset({"from", "side", "direction", "origin"})
_SIDES = frozenset({"left", "right", "the left", "the right"})
# {"lead_vehicle": {"type": "truck"}}
_ROLE = re.compile(
    r"[\"'](?:\w{2,20}_)?(?P<vehicle>vehicle)[\"']\s*:\s*\{\s*[\"'](?:type|class|category)[\"']\s*:"
    r"\s*[\"'](?P<value>\w{2,20})[\"']",
    re.IGNORECASE,
)


def preferences(
    text: str,
    values_of: Values,  # noqa: ARG001  # as every step has it
) -> Iterator[tuple[int, str]]:
    """Deny what another action is preferred to."""
    for match in _RATHER.finditer(text) if " than " in text else ():
        for group in ("would", "word"):
            yield match.start(group), " " * len(match[group])
        yield match.start("than"), "not "
    for match in _PREFERRED.finditer(text):
        group = match.lastgroup or "over"
        yield match.start(group) - 1, " not".ljust(len(match[group]) + 1)[: len(match[group]) + 1]


def set_aside(
    text: str,
    values_of: Values,  # noqa: ARG001  # as every step has it
) -> Iterator[tuple[int, str]]:
    """Blanks for fields of actions that are rejected, past or alternatives."""
    if "{" not in text:
        return
    for match in _FIELD.finditer(text):
        yield match.start(), " " * len(match.group())


def nested(text: str, values_of: Values) -> Iterator[tuple[int, str]]:
    """Take apart an object that says a motion in several fields, and a role with a class."""
    if "{" not in text:
        return
    for match in _ROLE.finditer(text):
        if values_of(match["value"]).get("objects"):
            yield match.start("vehicle") - 1, " " * (1 + len(match["vehicle"]))
    for match in _MOTION.finditer(text):
        object_text = match["object"]
        fields = list(_TEXT.finditer(object_text))
        motions = [one for one in fields if one["key"].lower() in _OF_MOTION]
        sides = [one for one in fields if one["key"].lower() in _OF_SIDE and motions]
        if not motions or (sides and sides[0].start() < motions[0].start()):
            continue
        flat = [" "] * len(object_text)
        _put(flat, motions[0].start("value") - 1, f'"{motions[0]["value"]}')
        end = motions[0].end("value")
        for one in sides[:1]:
            value, key = one["value"].lower(), one["key"].lower()
            if key == "direction" and value in _SIDES:
                continue  # it may be where it comes from, or where it goes
            if not value.startswith("from") and (key != "direction" or " to " in value):
                _put(flat, one.start("key"), "from")
            _put(flat, one.start("value"), one["value"])
            end = one.end("value")
        _put(flat, end, '"')
        yield match.start("object"), "".join(flat)


def _put(flat: list[str], at: int, text: str) -> None:
    flat[at : at + len(text)] = text
