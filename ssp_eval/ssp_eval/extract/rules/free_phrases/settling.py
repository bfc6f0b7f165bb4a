"""What settles a conflict: the conflict with the jogger is now fully over."""

from __future__ import annotations

from ssp_eval.extract.rules.words.notation import phrases

_SUBJECTS = frozenset(
    phrases(
        """
        crossing, conflict, risk, danger, threat, hazard, criticality, situation, interaction,
        encounter, issue, problem, conflicts, incident

        """
    )
)
_BETWEEN = frozenset(
    phrases(
        """
        is, has, was, been, now, already, therefore, fully, thus, completely, with, it, him, her,
        them, the, that, which, by, then, being, hence, entirely, finally, clearly, state, status,
        considered, at, this, are, so, and, from, potential, earlier, previous, as, be, can,
        critical,
        car, van, truck, cyclist, pedestrian, motorcycle, suv, sedan, bus, lorry, effectively,
        currently, to, us, present, there, just, left, right
        """
    )
)
_SETTLED = frozenset(
    phrases(
        """
        over, resolved, past, passed, ended, gone, cleared, settled, defused, disappeared,
        vanished, dissolved, finished, done, completed, averted, subsided, eliminated, removed,
        dissipated, active, behind

        """
    )
)
_UNSURE = frozenset(phrases("not, may, might, could, until, if, when, once, before, will, no, nor"))
HEADS = _SUBJECTS
MAX_BETWEEN = 6


def settled(words: list[str], at: int) -> int | None:
    """The word after "the conflict with it is now fully over"; None if it isn't over."""
    for back in words[max(at - 3, 0) : at]:
        if back in _UNSURE:
            return None
    partner = 0  # words of "with the jogger" may be any
    for here in range(at + 1, min(at + 4 + MAX_BETWEEN, len(words))):
        word = words[here]
        if partner and word not in _SETTLED:
            partner -= 1
            if word.isalpha():
                continue
        partner = 3 if word == "with" else partner
        if word in _SETTLED:
            after = words[here + 1] if here + 1 < len(words) else ""
            if word == "behind" and after != "us":
                return None
            return None if word in ("over", "past") and after in ("the", "a") else here + 1
        if word not in _BETWEEN:
            return None
    return None


def outcome(words: list[str], stop: int) -> str:
    """What a phrase that settled() has found makes of the conflict."""
    return "active" if words[stop - 1] == "active" else "resolved"
