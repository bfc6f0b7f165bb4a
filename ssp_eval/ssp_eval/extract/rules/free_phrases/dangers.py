"""What says that a conflict may come, or is there but for our action.

Without braking we'd hit it; might wobble out.
"""

from __future__ import annotations

from ssp_eval.extract.rules.words.notation import phrases

_CRASHES = frozenset(
    phrases(
        """
        hit, hits, crash, crashes, collide, collides, collision, strike, strikes, contact, impact,
        ram, rams, run, runs, bump, meet, accident, overrun, sideswipe, sideswipes, touch, touches,
        scrape, scrapes, graze, smash, knock
        """
    )
)
_WARDED = frozenset(
    phrases(
        """
        braking, reaction, reacting, action, acting, intervention, slowing, stopping, steering,
        evasive, response, responding, evading, brakes, countermeasure, deceleration
        """
    )
)
_OR_WE = frozenset(phrases("we, it, i, ego, the, there"))
_INTO = frozenset(phrases("into, over, onto"))
_URGENT = frozenset(phrases("immediately, now, once, urgently, instantly"))
_REACT = frozenset(phrases("react, respond, act, intervene"))
_AVOID = frozenset(phrases("avoid, avoids, prevent, prevents, avert, averts"))
# If we go on like this, we will hit him.
_GO_ON = frozenset(
    phrases("carry, continue, keep, proceed, go, drive, maintain, hold, stay, persist, remain")
)
_EXCEPT = frozenset(phrases("unless, without, if, otherwise, or, only"))
_DOUBTS = frozenset(phrases("may, might, could, possibly, potentially, not, no"))
_ACTS = frozenset(
    phrases(
        """
        brake, act, react, stop, slow, respond, do, does, yield, intervene, evade, decelerate,
        something, anything, steer, swerve, braked, stopped, reacted, acted, done, brakes, acts,
        reacts, stops, slows, responds, yields, intervenes, evades, decelerates, steers, swerves
        """
    )
)
# A sentence without one of these says nothing of the kind.
WARD = frozenset(
    phrases("or, otherwise, unless, without, if, react, act, respond, reaction, intervene, only")
)
_WE = frozenset(phrases("we, i, ego, you, vehicle, car, nothing, something, it, vut"))


def averted(words: list[str], first: int, stop: int) -> tuple[int, int] | None:
    """Where a sentence says that only our action prevents a crash, as words from and to.

    Args:
        words: words of the text.
        first: first word of the sentence.
        stop: word after it.
    """
    warded: int | None = None
    crash: int | None = None
    for at in range(first, stop):
        word = words[at]
        if word in _CRASHES:
            run = word in ("run", "runs")
            risked = words[at - 1] == "of" and words[at - 2] in (
                "risk",
                "danger",
                "chance",
            )
            if not risked and (not run or not _INTO.isdisjoint(words[at + 1 : at + 4])):
                crash = at
        elif word in _AVOID:
            averting = warded is not None and words[warded] == "only"
            if not averting and not _CRASHES.isdisjoint(words[at + 1 : at + 4]):
                if _URGENT.isdisjoint(words[first:at]) or _REACT.isdisjoint(words[first:at]):
                    return None
                warded = at  # we must react at once to avoid a collision
        elif word in _EXCEPT and _except(words, at, stop):
            warded = at
        elif word in _DOUBTS and not (word in ("not", "no") and warded is not None):
            return None
    if warded is None or crash is None:
        return None
    return min(warded, crash), max(warded, crash) + 1


def crashes(words: list[str], at: int) -> bool:
    """Whether a crash follows may or could: we could run into it."""
    word = words[at] if at < len(words) else ""
    into = words[at + 1 : at + 2]
    if word == "rear":
        return words[at + 1 : at + 2] == ["end"]
    return word in _CRASHES and (word not in ("run", "meet") or not _INTO.isdisjoint(into))


def _except(words: list[str], at: int, stop: int) -> bool:
    if words[at] == "otherwise":
        return True
    if words[at] == "or":  # or it will hit him
        near = words[at + 1 : min(at + 5, stop)]
        return bool(near) and near[0] in _OR_WE and bool({"will", "would", "shall"} & set(near))
    if words[at] == "only":
        near = words[at + 1 : min(at + 8, stop)]
        return not _WARDED.isdisjoint(near) and not _AVOID.isdisjoint(near)
    if words[at] == "without":
        return not _WARDED.isdisjoint(words[at + 1 : min(at + 4, stop)])
    return _we_act(words, at + 1, stop, negated=words[at] == "if")


def _we_act(words: list[str], at: int, stop: int, negated: bool) -> bool:
    """unless we brake; if we do nothing, if nothing is done, if we don't stop."""
    near = words[at : min(at + 6, stop)]
    if not near or not _WE & set(near[:3]):
        return False
    if negated and near[0] in _WE and not _GO_ON.isdisjoint(near[:4]):
        return True
    return bool(_ACTS & set(near)) and (not negated or "not" in near or "nothing" in near)


_THREATS = frozenset(
    phrases(
        """
        set, step, walk, run, go, start, move, come, swing, wobble, swerve, pull, drift, veer, dart,
        dash,
        jump, cross, enter, cut, merge, turn, brake, stop, open, emerge, appear, pop, fall, hit,
        collide, strike, lose, change, squeeze, roll, encroach, wander, rush, intrude, slip, shoot,
        crash, ram, deviate, force, barge, sway, spill, skid, stumble, leap, push, hop, ride, drive,
        stray, hide, conceal, mask, obscure, shift, edge, lurch, slide, spring, surprise, burst,
        nip, bolt, hurry, sprint, rear, reverse, endanger, conflict, interfere, cause,
        pose, become, slow, decelerate, leave, steer, tip, topple, u, lane, overtake, try, decide,
        want, begin, suddenly, attempt, block, obstruct, cover, occlude, re, get, sideswipe, clip,
        scrape, graze, brush, touch, squash, crush, back, follow, knock, meet, trap, crowd, pinch
        """
    )
)
# What needs more to be a threat: get into, leave its lane, become a hazard.
_COMPLETED = {
    "get": frozenset(
        phrases(
            "into, in, out, onto, off, closer, across, too, tight, critical, dangerous, hit, worse"
        )
    ),
    "back": frozenset(phrases("out, into, up, onto, across")),
    "follow": frozenset(phrases("it, him, her, them")),
    "meet": frozenset(phrases("us, me, in")),
    "become": frozenset(
        phrases("a, critical, dangerous, relevant, hazardous, an, tight, one, risky")
    ),
    "pose": frozenset(phrases("a, risk, danger, risks, hazard")),
    "cause": frozenset(phrases("a, an, conflict, danger")),
    "drive": frozenset(phrases("into, out, off, across, in, onto, over")),
    "ride": frozenset(phrases("into, out, off, across, in, onto, over")),
    "re": frozenset(phrases("enter, appear, emerge")),
    "set": frozenset(phrases("off, out")),
    "leave": frozenset(phrases("its, the, his, her, their, too, little, no, insufficient")),
    "u": frozenset(phrases("turn")),
    "lane": frozenset(phrases("change")),
    "cover": frozenset(phrases("somebody, a, someone, people, pedestrians, anybody, anyone")),
    "block": frozenset(phrases("our, the, us, my")),
}
# What somebody runs after.
_LURES = frozenset(phrases("ball, balls, dog, toy, pet, others, friends, friend, group, balloon"))
_ADVERBS = frozenset(
    phrases(
        """
        suddenly, still, also, then, soon, well, unexpectedly, abruptly, easily, even, just,
        quickly, now, yet, therefore, always, at, any, moment, time, again, of, course, perhaps,
        really, actually, simply, later, attempt, try, decide, begin, start, want, next
        """
    )
)
MAX_ADVERBS = 5


def threat(words: list[str], at: int) -> int | None:
    """The word after what somebody may do to us, from the word after may, might or could.

    None for what endangers nobody (may continue, might have stopped, could be ignored).
    """
    here = at
    count = len(words)
    while here < min(at + MAX_ADVERBS, count) and words[here] in _ADVERBS:
        here += 1
    if here >= count:
        return None
    if here > at and words[here] == "to" and here + 1 < count:
        here += 1
    word = words[here]
    if word not in _THREATS:
        return here if here > at and words[here - 1] in ("start", "begin") else None
    needed = _COMPLETED.get(word)
    after = words[here + 1] if here + 1 < count else ""
    if word == "follow" and not _LURES.isdisjoint(words[here + 2 : here + 4]):
        return here + 1
    if needed is not None and after not in needed:
        return None
    if word in ("block", "obstruct") and "view" in words[here : here + 4]:
        return None
    if word == "go" and after in ("yellow", "red", "green", "amber"):
        return None
    if word == "stop" and after in ("for", "to", "before", "in", "safely"):
        return None
    return here + 1
