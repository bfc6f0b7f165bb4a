"""Fields: a label that is a field's name is asserted or denied by its value (METHOD 5.5)."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ssp_eval.extract.asserted.labels import ACTIONS, CLEAR, NAME, QUOTES, SIDES, Values, words

_CHOSEN = ("accepted", "chosen", "selected")
_FOUND, _NOT_FOUND = ("present", "positive"), ("absent", "negative")
_APPLIED = ("enabled", "engaged", "applied")
_NOT_APPLIED = (
    *(f"not {word}" for word in (*_APPLIED, "needed", "required", "necessary")),
    *("disabled", "disengaged", "released"),
)
_YES = frozenset({"true", "yes", "✓", "✔", "☑", "✅", "on", "t", "y", *_CHOSEN, *_FOUND, *_APPLIED})
_REFUSED = ("rejected", "cancelled", "canceled", "denied", "aborted", "refused", "discarded")
_NO = frozenset(
    {"false", "no", "✗", "✘", "☒", "❌", "n", "off", "f", "none", "null"}
    | {*_REFUSED, *_NOT_FOUND, *_NOT_APPLIED}
)
# Words that deny a manoeuvre; of nobody's presence the rules read them.
_NO_ACTION = frozenset({"none", "null", "off"})
_FEW_WORDS = 3
_OF_NUMBER = frozenset("-−.0123456789")  # its first sign
_SHARE = r"[-−]?(?:\d+(?:\.\d+)?|\.\d+)\s*%?"
_SIGN = "[✓✔☑✅✗✘☒❌]"
_WORD_VALUE = (
    r"(?:(?:true|false|yes|no|on|off|none|null|present|absent|positive|negative|"
    + "|".join((*_CHOSEN, *_REFUSED, *_APPLIED, *_NOT_APPLIED))
    + rf")\b|{_SIGN}"
    r"|(?-i:[TFYN])\b)"
)
# Behind a sign, or two blanks, may stand the next field.
_FIELD_END = (
    r"(?=\s*(?:[,;}\])\n|(]|\.(?:\s|$)|$)|\s{2}|(?<=[✓✔☑✅✗✘☒❌])\s"
    r"|(?<=[\"'])\s*/?>|(?<=[\"'])\s+[\w-]{2,30}=[\"'])"  # of a tag's attribute
)
_SHARE_KEY = r"(?:score|prob\w*|confidence|p|weight|likelihood|share)"
# {"pedestrian": {"present": false}}, {"brake": {"prob": 0.8}}, and the same as lines of YAML.
_NESTED = (
    r"(?:(?:\{\s*(?:[\"']\w{2,20}[\"']\s*:\s*(?:[\"'][^\"'{}\n]{0,200}[\"']|[\w.]{1,12})\s*,\s*){0,2}"
    r"[\"']|(?<=[ \t]))(?:(?:present|detected|visible|exists|active|selected|needed)"
    rf"|(?P<shared>{_SHARE_KEY}))[\"']?\s*:\s*)"
)
# What else stands in the object, or below the name, of a share.
_REST = re.compile(
    r"[^{}\n]{0,400}(?:\n[ \t][^{}\n]{0,400}){0,8}\n?\}|(?:\n[ \t][^{}\n]{0,400}){1,8}"
)
_FIELD = re.compile(
    rf"(?P<key>{QUOTES}{NAME}{QUOTES})(?:\s*[:=]{QUOTES}\s*{_NESTED}?"
    rf"(?P<value>{QUOTES}(?:{_WORD_VALUE}|{_SHARE}){QUOTES})"
    rf"|(?:\s*(?:→|[=-]>)|[ \t]+[-–—](?=\s))\s*(?P<word>{QUOTES}{_WORD_VALUE}{QUOTES})"
    r"|\?[ \t]+(?P<reply>yes|no))"
    rf"{_FIELD_END}"
    # <brake>false</brake>, | brake | no |, P(brake) = 0.8
    rf"|<(?P<tag>\w{{2,30}})>\s*(?P<in_tag>{_WORD_VALUE}|{_SHARE})\s*</(?P=tag)>"
    rf"|(?<=\|)[ \t*]*(?P<cell>{NAME})[ \t*]*\|"
    rf"[ \t*]*(?P<in_cell>{_WORD_VALUE}|{_SHARE})[ \t*]*(?=\|)"
    rf"|\bp(?:rob(?:ability)?)?\((?P<of>{NAME})\)\s*[:=]\s*(?P<share>{_SHARE}){_FIELD_END}"
    # {"action": "brake", "score": 0.8}
    r"|\{\s*[\"'](?:action|label|name|option|class|man(?:o?eu|eu)ver|manoeuvre|plan)[\"']\s*:\s*"
    rf"[\"'](?P<label>{NAME})[\"']\s*,\s*[\"']{_SHARE_KEY}[\"']"
    rf"\s*:\s*(?P<score>{_SHARE})\s*\}}"
    # ["brake", 0.8]
    rf"|[\[(]\s*(?P<paired>{QUOTES}{NAME}{QUOTES})\s*,\s*(?P<with>{_SHARE})\s*[\])]"
    # brake (80 %), 80 % brake
    rf"|(?P<before>{NAME})\s*[(\[](?P<beside>{_SHARE}|{_WORD_VALUE})[)\]]"
    rf"|(?P<first>\d+(?:\.\d+)?\s*%)\s+(?:for\s+|to\s+)?(?P<behind>{NAME}){_FIELD_END}"
    # brake 80 %, keep 20 %; brake 0.8, keep 0.2
    rf"|(?P<ahead>{NAME})\s+(?P<follows>\d+(?:\.\d+)?\s*%|[01]?\.\d+){_FIELD_END}"
    # brake ✗, keep ✓
    rf"|(?P<ticked>{NAME})[ \t]+(?P<sign>{_SIGN}){_FIELD_END}",
    re.IGNORECASE,
)
# A line whose signs stand before the names: "✅ brake ❌ keep".
_SIGN_FIRST = re.compile(rf"[^\w\n✓✔☑✅✗✘☒❌]*{_SIGN}")
_PARTS = (
    ("key", "value"),
    ("key", "word"),
    ("key", "reply"),
    ("tag", "in_tag"),
    ("cell", "in_cell"),
    ("of", "share"),
    ("label", "score"),
    ("paired", "with"),
    ("before", "beside"),
    ("behind", "first"),
    ("ahead", "follows"),
    ("ticked", "sign"),
)
# Of these forms one alone is a remark: "I brake (80 %)".
_NEVER_ALONE = frozenset({"label", "paired", "before", "behind", "ahead"})
# A motion as a field's name, of a road user that is named elsewhere.
_OF_MOTION = frozenset({"motion"})
_NAMES_MOTION = re.compile(
    r"(?:is |object |motion )?(?:stationary|stopped|parked|standing(?: still)?|oncoming"
    r"|same direction|(?:crossing|cutting in)(?: from (?:the )?(?:left|right))?)"
)
_MOST_INDENT = 40  # of a field's line
_SLACK = 0.05  # of what rounded shares have together
_LEAST_RATED = 2  # conflicts in one object
# {"conflict": {"potential": 0.2, "active": 0.8}}
_RATED_CONFLICTS = re.compile(
    r"\bconflict(?:[ _](?:status|state|level|type))?[\"']\s*:\s*(?P<inside>\{[^{}]*\})",
    re.IGNORECASE,
)
_RATED = re.compile(
    rf"[\"'](?P<name>[\w ]{{3,24}})[\"']\s*:\s*(?P<value>[\"']?(?:{_WORD_VALUE}|{_SHARE})[\"']?)"
    r"\s*(?=[,}])",
    re.IGNORECASE,
)
_MAY_HOLD_FIELD = re.compile(
    rf"(?:[:=>|→?]|[-–—]\s)[\s\"'*_]{{0,4}}(?:{_WORD_VALUE}|{_SHARE}[\"'*]*(?:[\s,;}}\])|<]|$))"
    rf"|[(\[](?:{_SHARE}|{_WORD_VALUE})[)\]]|%[\s,;.]|=[\"']|\w[ \t]+(?:{_SIGN}|[01]?\.\d)"
    rf"|[a-z][\"']?\s*,\s*{_SHARE}\s*[\])]",
    re.IGNORECASE,
)
# Behind a field that says no more than its name.
_BEHIND_FIELD = re.compile(r"\s*(?:$|[\n}\]|;<]|,\s*(?:[\"'\n]|$|[\w ]{1,24}[:=])|\.\s*(?:\n|$))")


@dataclass(frozen=True)
class _Field:
    value: str
    span: tuple[int, int]
    key_span: tuple[int, int]
    slots: frozenset[str]
    never_alone: bool
    after: int  # where its object ends
    paired: bool = False

    @property
    def start(self) -> int:
        return self.span[0]

    @property
    def end(self) -> int:
        return self.span[1]

    def named(self, text: str) -> str:
        """Its name as a sentence, with blanks for the rest."""
        start, end = self.key_span
        # A side alone is read where a mark says that it is a value; a motion is its road user's.
        stop = "]." if words(text[start:end]) in SIDES else "" if self.slots == _OF_MOTION else "."
        stop = stop[: self.end - end]
        return (" " * (start - self.start) + text[start:end] + stop).ljust(self.end - self.start)


def fields(text: str, values_of: Values) -> Iterator[tuple[int, str]]:
    """Blanks for the fields whose name isn't asserted, and for the values of those that are."""
    if _MAY_HOLD_FIELD.search(text) is None:
        return
    candidates = []
    for match in _FIELD.finditer(text):
        name, value = next((n, v) for n, v in _PARTS if match[v] is not None)
        key = words(match[name].strip("\"'*_"))
        value_text = match[value].strip("\"'*_ ").lower()
        slots = frozenset(SIDES.get(key) or values_of(key))
        if not slots and name != "cell" and _NAMES_MOTION.fullmatch(key):
            slots = _OF_MOTION
        count = len(key.split())
        if value_text in _NO_ACTION and (count > _FEW_WORDS or slots - ACTIONS):
            continue
        if name == "ticked" and _SIGN_FIRST.match(text, text.rfind("\n", 0, match.start()) + 1):
            continue
        # "Brake? Yes." is a field, and a question of several words is none.
        if value == "reply" and (count > 2 or slots - ACTIONS):
            continue
        if slots:
            alone = name in _NEVER_ALONE or match["shared"] is not None
            if name == "paired" and slots - ACTIONS:
                continue
            bare = re.search(r"[^\"'*_ ].*[^\"'*_ ]|[^\"'*_ ]", match[name], re.DOTALL)
            start, end = bare.span() if bare is not None else (0, len(match[name]))
            span = match.start(name) + start, match.start(name) + end
            after = match.end()
            if match["shared"] is not None:
                behind = match.start() + len(match.group().rstrip())
                rest = _REST.match(text, behind)
                after = after if rest is None else rest.end()
            paired = name == "paired" or (name == "ahead" and "%" not in value_text)
            candidates.append(_Field(value_text, match.span(), span, slots, alone, after, paired))
    for group in _groups(text, candidates):
        for one, holds in zip(group, _holding(group), strict=True):
            if holds is False:
                yield one.start, " " * (one.end - one.start)
            elif holds and _says_name_alone(one, text, values_of):
                yield one.start, one.named(text)
                line_end = text.rfind("\n", max(0, one.start - _MOST_INDENT), one.start)
                if line_end >= 0 and not text[line_end : one.start].strip():
                    # The line before is no part of it.
                    yield line_end, "," if one.slots == _OF_MOTION else "."


def conflicts(text: str, values_of: Values) -> Iterator[tuple[int, str]]:
    """Blanks for the values of an object of conflicts, but for the one that it asserts."""
    for match in _RATED_CONFLICTS.finditer(text):
        start, end = match.span("inside")
        group = []
        for one in _RATED.finditer(text, start, end):
            rating = one["value"].strip("\"'").lower()
            if "conflict" in values_of(f"conflict: {words(one['name'])}"):
                slots = frozenset({"conflict"})
                group.append(_Field(rating, one.span(), one.span("name"), slots, False, one.end()))
        assertions = [one for one, holds in zip(group, _holding(group), strict=True) if holds]
        if len(group) < _LEAST_RATED:
            continue
        yield start, " " * (end - start)
        if len(assertions) == 1:
            (name_start, name_end) = assertions[0].key_span
            yield name_start, text[name_start:name_end] + "."


def _says_name_alone(one: _Field, text: str, values_of: Values) -> bool:
    """Tell whether a field says no more than its name, which the rules don't read in it."""
    # Motions are read beside their road user in quotes, and in lines without a value.
    if one.slots == _OF_MOTION and text[one.start] in "\"'":
        return False
    if "objects" in one.slots or _BEHIND_FIELD.match(text, one.end) is None:
        return False
    return not one.slots <= values_of(text[one.start : one.end]).keys()


def _groups(text: str, fields: Sequence[_Field]) -> Iterator[list[_Field]]:
    """Fields side by side, of the same slots."""
    group: list[_Field] = []
    for one in fields:
        between = text[group[-1].after : one.start] if group else ""
        if group and (len(between) > 8 or re.search(r"[\w}\]]", between)):
            yield group
            group = []
        group.append(one)
    if group:
        yield group


def _holding(group: Sequence[_Field]) -> list[bool | None]:
    """Tell whether each field of a group asserts its name; None where its value can't say."""
    verdicts: list[bool | None] = []
    # Pairs whose numbers aren't shares may be actions with their times.
    pairs = [one.value for one in group if one.paired]
    whole = sum(float(value.rstrip("% ").replace("−", "-")) for value in pairs)
    percent = any("%" in value for value in pairs) or abs(whole - 100.0) < _SLACK * 100.0
    no_shares = not percent and whole > 1.0 + _SLACK
    for one in group:
        if (one.never_alone and len(group) == 1) or (one.paired and no_shares):
            verdicts.append(None)
        elif one.value in _YES | _NO:
            verdicts.append(one.value in _YES)
        elif "objects" in one.slots:
            verdicts.append(one.value[0] not in "-−" and float(one.value.rstrip("% ")) > 0)
        else:
            verdicts.append(_leads(one, group))
    return verdicts


def _leads(one: _Field, group: Sequence[_Field]) -> bool | None:
    """Tell whether a share is the clear maximum of those of its slot."""
    same = [other for other in group if other.slots & one.slots and other.value[:1] in _OF_NUMBER]
    if any(other.value[0] in "-−" for other in same):  # no shares, but scores of another kind
        return None if len(same) == 1 else False
    shares = [(float(other.value.rstrip("% ")), "%" in other.value) for other in same]
    whole = 100.0 if any(p for _, p in shares) or max(v for v, _ in shares) > 1.0 else 1.0
    own = float(one.value.rstrip("% ")) / whole
    if len(same) == 1:
        return own >= 0.5 + CLEAR / 2 if whole == 100.0 or one.value not in "01" else own == 1.0
    others = [v / whole for other, (v, _) in zip(same, shares, strict=True) if other is not one]
    return own - max(others) >= CLEAR - 1e-9
