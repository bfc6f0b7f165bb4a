"""Stage 1: text to words with character offsets. One pass, no backtracking, any string."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass
from itertools import pairwise

from ssp_eval.extract.asserted.labels import HUMP


def _base(letter: str) -> str:
    """Return the plain letter of one with an accent, else nothing: coupé is coupe."""
    first = unicodedata.normalize("NFD", letter)[0]
    return first if first.isascii() and first != letter else ""


# One character for one, so that offsets stay those of the text.
_PLAIN = {
    **dict.fromkeys(map(ord, "\u2018\u2019\u02bc\u00b4`"), "'"),
    **dict.fromkeys(map(ord, "\u201c\u201d\u00ab\u00bb"), '"'),
    **dict.fromkeys(map(ord, "\u2010\u2011\u2022\u25cf\u25e6"), "-"),
    **dict.fromkeys(map(ord, "\u2013\u2014"), ","),
    **dict.fromkeys(map(ord, "\u00a0\u2009\u202f\r"), " "),
    **dict.fromkeys(map(ord, "\u2028\u2029"), "\n"),
    **dict.fromkeys(map(ord, "\u3002\u2026"), "."),
    **dict.fromkeys(map(ord, "\uff0c\u3001"), ","),
    ord("\u2192"): ">",
    **{code: base for code in range(0xC0, 0x180) if (base := _base(chr(code)))},
    ord("\uff1a"): ":",
    ord("\uff1b"): ";",
    ord("\u2212"): "-",
}

# Alternatives are disjoint in their first character, except for the tag, whose length is bounded.
_TOKEN = re.compile(
    r"(?:i\.e|e\.g)\b\.?|(?:const|approx|resp|incl|veh|ped)\.|[a-z]+(?:'[a-z]+)*|[0-9]+(?:\.[0-9]+)*|</?[a-z_|]{1,24}>|[.!?]+|\n\s*"
    r"|,+|;+|:+|\"+|=+|\|+|\[[x ]\]|[()\[\]{}<>][()\[\]{}<> ]*|(?<=\s)[-*]+(?=\s)|[^\x00-\x7f]+"
)


# Boxes of a form; what stands behind an empty one isn't said.
_TICKS = {
    **dict.fromkeys(("[ ]", "\u2610", "\u2b1c", "\u25a1", "\u274c", "\u2717"), "unticked"),
    **dict.fromkeys(("[x]", "\u2611", "\u2705", "\u2714", "\u2713"), "ticked"),
}
_FIXED = {
    **dict.fromkeys(("cannot", "cant", "dont", "doesnt", "isnt", "wont"), "not"),
    "let's": "we",
    "travelling": "traveling",
    "travelled": "traveled",
    "signalling": "signaling",
    "pedalling": "pedaling",
    "pedalled": "pedaled",
    "const.": "constant",
    "veh.": "vehicle",
    "ped.": "pedestrian",
    "approx.": "about",
    "incl.": "with",
    "resp.": "or",
    **dict.fromkeys(("lt", "lh"), "left"),
    **dict.fromkeys(("rt", "rh"), "right"),
    "ln": "lane",
    "lns": "lanes",
    "fm": "from",
    "frm": "from",
    "n": "and",
    **dict.fromkeys(("i.e", "i.e.", "e.g", "e.g."), ","),
}
_SIDES = {"l": "left", "r": "right"}
_BEFORE_SIDES = frozenset(
    {
        "on",
        "from",
        "front",
        "rear",
        "ahead",
        "ramp",
        "alley",
        "kerb",
        "curb",
        "shift",
        "nudge",
        "steer",
        "turn",
        "move",
        "swerve",
        "alongside",
        "pass",
        "mirror",
        "far",
        "keep",
        "spot",
        "behind",
        "merge",
        "change",
        "go",
        "over",
        "pavement",
        "near",
    }
)
_AFTER_SIDES = frozenset(
    {
        "lane",
        "lanes",
        "ln",
        "kerb",
        "curb",
        "side",
        "shoulder",
        "edge",
        "pavement",
        "turn",
        "verge",
        "ramp",
        "rear",
        "front",
        "bay",
        "hand",
        "mirror",
        "sidewalk",
        "h",
    }
)
_OTHERS = frozenset({"he", "she", "it", "they", "that", "who", "which"})
_OPENERS: tuple[list[str], ...] = ([], [":"], ["."], ["\n"])
_DROPPED = ""
_MINUS = frozenset("-\u2212\u2013")
_SINGLE = frozenset(',;:"=|')
# A line whose sentence goes on behind it: it ends so, or it is a condition without its other half.
_ENDS_LIST = re.compile(r"\d\s*[\])]+$")  # of numbers, behind which no sentence goes on
_RUNS_ON = re.compile(
    r"(?:,|\b(?:and|or|but|so|if|when|while|because|since|as|that|then|until|unless|before|after"
    r"|where|which|than|what|how|whether))\Z"
    r"|\A\W*(?:if|when|whenever|once|unless|should|in case|as soon as)\b[^,:;.]*\Z",
    re.IGNORECASE,
)
_LEAST_WIDTH = 40  # characters of a line that is wrapped
_LISTS = "\u2022\u25cf\u25e6-*#>|0123456789\"'[({<"

FIELD_NAME = 24  # characters in which the name of a field at the start of a line must end

SENTENCE_END = "."
QUESTION = "?"
BREAK = "\n"
FOREIGN = "~"


@dataclass(frozen=True, slots=True)
class Tokens:
    """The words of a text in plain lower case, with their half-open character spans.

    Words are letters only, so that ``cut-in``, ``cut_in`` and ``cut in`` are the same two words; a
    possessive or contracted ending is folded away (``don't`` becomes ``not``). Marks are words of
    one character: the constants above and ``, ; : " = | [ ( { < ) } >``; a run of brackets is one.

    Args:
        words: the words and marks.
        found: where each stands; offsets are asked for few of them only.
    """

    words: list[str]
    found: list[re.Match[str]]

    @property
    def starts(self) -> list[int]:
        """The start of each word, characters."""
        return [match.start() for match in self.found]

    @property
    def ends(self) -> list[int]:
        """The end of each word, characters."""
        return [match.end() for match in self.found]

    def span(self, first: int, stop: int) -> tuple[int, int]:
        """Return the characters from word ``first`` up to but without word ``stop``."""
        return self.found[first].start(), self.found[stop - 1].end()


def plain(text: str) -> str:
    """Return the text in lower case with plain quotes and dashes, character for character."""
    if not text.isascii():
        text = text.translate(_PLAIN)
        lower = text.lower()
        if len(lower) != len(text):
            lower = "".join(c.lower() if len(c.lower()) == 1 else c for c in text)
        return lower
    return text.lower().replace("`", "'").replace("\r", " ")


def tokenise(text: str) -> Tokens:
    """Return the words of a text with their offsets."""
    lower = _without_struck(plain(text))
    ends = [0, *(hump.start() for hump in HUMP.finditer(text)), len(lower)]
    matches = [match for pair in pairwise(ends) for match in _TOKEN.finditer(lower, *pair)]
    words = [match.group() for match in matches]
    for index, word in enumerate(words):
        first = word[0]
        if "a" <= first <= "z":
            fixed = _FIXED.get(word)
            if fixed is not None:
                words[index] = fixed
            elif "'" in word:
                words[index] = _fold(word)
        elif not "0" <= first <= "9":
            if (
                first == "\n"
                and word.count("\n") < 2
                and not _starts_item(text, matches[index].end())
            ):
                words[index] = _DROPPED
                continue
            words[index] = _mark(word)
            if words[index] == SENTENCE_END and _numbers_item(words, index):
                words[index] = BREAK
    _sides(words)
    if _DROPPED in words:
        matches = [match for match, word in zip(matches, words, strict=True) if word]
        words = [word for word in words if word]
    if "accel" in words:
        _sign_accelerations(words, matches, lower)
    return Tokens(words, matches)


def _sign_accelerations(words: list[str], matches: list[re.Match[str]], text: str) -> None:
    """Name accelerations by their sign: accel: -6 is a deceleration, accel: 0 a steady speed."""
    for index, word in enumerate(words[:-2]):
        value = words[index + 2]
        if word == "accel" and words[index + 1] in (":", "=") and value[0].isdigit():
            negative = text[matches[index + 2].start() - 1] in _MINUS
            zero = not value.strip("0.")
            words[index] = "cruise" if zero else "decel" if negative else word


def _sides(words: list[str]) -> None:
    """Write out the sides of notes: on L, R lane, front-l."""
    for index, word in enumerate(words):
        if word in _SIDES:
            before = words[index - 1] if index else ""
            after = words[index + 1] if index + 1 < len(words) else ""
            if before in _BEFORE_SIDES or after in _AFTER_SIDES:
                words[index] = _SIDES[word]
                if after == "h":
                    words[index + 1] = "hand"


def _without_struck(text: str) -> str:
    """Blanks what is struck out, ~~so~~, character for character."""
    if "~~" not in text:
        return text
    parts = text.split("~~")
    for at in range(1, len(parts) - 1, 2):
        parts[at] = " " * len(parts[at])
    return "  ".join(parts)


def _numbers_item(words: list[str], index: int) -> bool:
    """Tell whether a full stop belongs to the number of a list's item."""
    return (
        index > 0
        and words[index - 1].isdigit()
        and words[max(index - 2, 0) : index - 1] in _OPENERS
    )


def _fold(word: str) -> str:
    if word == "i'd":
        return word
    if word.endswith("n't"):
        return "not"
    stem, _, ending = word.partition("'")
    if ending == "ll" and stem in _OTHERS:
        return "will"
    return "would" if ending == "d" else stem


def _mark(word: str) -> str:
    """Return the mark that a token without letters or digits at its start stands for."""
    first = word[0]
    if first in _SINGLE:
        return first
    if first in ".!?":
        return QUESTION if "?" in word else SENTENCE_END
    if first == "\n" or (first == "<" and len(word) > 2 and word[-1] == ">"):
        return BREAK
    if word in _TICKS or first in _TICKS:
        return _TICKS.get(word) or _TICKS[first]
    if first in "()[]{}<>":
        return "[" if "[" in word or "]" in word else first
    return "," if first in "-*" else FOREIGN


def _starts_item(text: str, start: int) -> bool:
    """Tell whether a line looks like a new item rather than the rest of a wrapped sentence."""
    if start >= len(text):
        return True
    first = text[start]
    if first in _LISTS or first.isupper():
        return text[start : start + 2] != "I " or not _is_wrapped(text, start)
    head = text[start : start + FIELD_NAME]
    colon = max(head.find(":"), head.find("="))
    return colon > 0 and head[:colon].count(" ") < 3 and "\n" not in head[:colon]


def _is_wrapped(text: str, start: int) -> bool:
    """Tell whether a line that begins with "I" goes on with the sentence of the line before.

    A line is wrapped where the next word doesn't fit: the line behind it isn't longer than that.
    """
    end = text.rfind("\n", 0, start)
    before = text[text.rfind("\n", 0, end) + 1 : end].rstrip()
    if _RUNS_ON.search(before) is not None:
        return True
    if _ENDS_LIST.search(before) is not None:
        return False
    stop = text.find("\n", start)
    length = (len(text) if stop < 0 else stop) - start
    opens_item = before.lstrip()[:1] in _LISTS and text[end + 1 : start] == ""
    return not opens_item and len(before) >= max(_LEAST_WIDTH, length - 1)
