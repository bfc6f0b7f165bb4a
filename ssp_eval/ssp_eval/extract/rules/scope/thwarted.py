"""Stage 4a: a manoeuvre that somebody blocks is a plan of ours, and neither his nor what we do.

"a car blocking an immediate merge to the left", "a merge to the left is blocked by a car"
(LABELLING.md, settled cases). A lane, path or view that is blocked is
none: what follows then is somebody's motion, or the plan.
"""

from __future__ import annotations

from ssp_eval.extract.rules.hits import Hit
from ssp_eval.extract.rules.words.notation import phrases

# Words that a look to either side covers, so that the whole stays linear.
_BACK, _AHEAD = 7, 9
_VERBS = ("block", "obstruct", "hinder", "hamper", "impede", "thwart", "preclude", "inhibit")
_STEMS = tuple(verb.removesuffix("e") for verb in _VERBS)
_HINDERING = frozenset(stem + end for stem in _STEMS for end in ("", "e", "s", "es", "ing"))
_HINDERED = frozenset(stem + "ed" for stem in _STEMS) | {"prevented", "barred"}
# Where something else begins, or what else can be blocked: behind it stands another assertion.
_ENDS = frozenset(
    phrases(
        """
        and, but, or, so, because, since, as, while, is, are, was, were, has, have, that, which,
        who, where, with, then, lane, lanes, path, way, road, street, view, sight, traffic,
        crosswalk, crossing, intersection, junction, exit, entrance, sidewalk, pavement, shoulder,
        side, line, vision, passage, us, we, i
        """
    )
)
_FROM = "from"
_PASSIVE = frozenset(phrases("is, are, was, were, being, be, been, remains, currently, now, also"))
_NEW = frozenset(
    phrases(
        """
        and, but, or, so, because, since, as, while, that, which, who, where, with, then, due,
        given, we, i, our, my, us, if, until, unless, when, after, before, not
        """
    )
)


def is_thwarted(words: list[str], verb: Hit) -> bool:
    """Whether a verb names a manoeuvre that somebody is said to block.

    Args:
        words: of the text, marks among them.
        verb: a hit of that kind.
    """
    if verb.form not in ("base", "ing", "noun"):
        return False
    return _is_object(words, verb.first) or (verb.form != "base" and _is_subject(words, verb.stop))


def _is_object(words: list[str], first: int) -> bool:
    """blocking an immediate merge, blocks us from merging."""
    is_ours = False
    for at in range(first - 1, max(first - _BACK, 0) - 1, -1):
        word = words[at]
        if word in _HINDERING:
            return True
        if word == _FROM and at == first - 1:
            is_ours = True
        elif not word[0].isalpha() or (word in _ENDS and not (is_ours or word == "us")):
            return False
    return False


def _is_subject(words: list[str], stop: int) -> bool:
    """a merge to the left is blocked, merging left blocked by a car."""
    for at in range(stop, min(stop + _AHEAD, len(words))):
        word = words[at]
        if word in _HINDERED:
            follows = words[at + 1] if at + 1 < len(words) else ""
            return words[at - 1] in _PASSIVE or follows == "by"
        if not word[0].isalpha() or word in _NEW:
            return False
    return False
