"""Stage 3d: phrases about the ego's lane and wheel, and the short values of action fields."""

from __future__ import annotations

from ssp_eval.extract.lexicon import phrases

Found = tuple[str, str, int, int]

# Whose lane it is that somebody stays or brakes in.
OWN_LANE = phrases(
    """
    our, my, its, the ego, the current, our own, my own, its own, the own, the same, the, own,
    this, the present, the ego vehicle, our current, its current, your, your own, ego
    """
)
IN_PATH = phrases(
    """
    in the path of the ego, in the path of the ego car, in the path of the ego vehicle, in the
    path of our car, in the path of our vehicle, in the ego vehicle path, in our
    driving path, in our driving corridor, inside our driving corridor, in our corridor, in my way
    """
)
SAME_LANE = phrases("in lane, same lane, without leaving the lane, without leaving our lane")

_WHEELS = frozenset(phrases("wheel, wheels, steering"))
_HELD = frozenset(
    phrases(
        """
        wheel, held, kept, is, stays, remains, be, should, stay, as, it, the, a, at, dead, all,
        completely, to, must, input, angle, command, pointed, pointing, set, of, remain
        """
    )
)
_NEUTRAL = frozenset(phrases("straight, neutral, centered, centred"))
_NO_STEERING = frozenset(
    phrases(
        """
        steer, evasive, active, further, additional, extra, lateral, steering, any, sudden, more,
        need, of, for, a, sideways, correction, corrections, sharp

        """
    )
)
_STEERING = frozenset(phrases("steering, steer"))
_SIDEWAYS = frozenset(phrases("lateral, sideways"))
_MOVES = frozenset(
    phrases(
        "movement, action, motion, maneuver, manoeuvre, shift, deviation, change, offset, input"
    )
)
_UNCHANGED = frozenset(phrases("unchanged, unaltered, same"))
_PASSIVE = frozenset(phrases("is, will, should, be, can, must, to, being, shall, also, then"))
_COURSES = frozenset(phrases("direction, heading, course, steering"))
_THROUGH = frozenset(phrases("on, through"))
_DIRECTIONS = (["direction"], ["heading"], ["course"], ["steering"])
_COURSE = tuple([word] for word in sorted(_COURSES))
HEADS = _WHEELS | frozenset(phrases("straight, no, zero, lane, direction, heading, course"))
_MARKS = frozenset({".", "?", "\n", ",", ";", ":", '"', "|", "[", "=", "("})

# Names of fields that are a field of the plan only where one of the values below follows.
FIELDS = {
    **dict.fromkeys(
        phrases(
            """
            speed, velocity, v, throttle, pace, longitudinal control, speed command, lon,
            speed action, target speed, ego speed, our speed, v target, target velocity,
            speed target, desired speed, speed plan, speed decision
            """
        ),
        "speed",
    ),
    **dict.fromkeys(
        phrases("speed change, acceleration, change of speed, change in speed"), "pace"
    ),
    **dict.fromkeys(
        phrases(
            """
            lane, steering, steer, steering command, path, heading, lane decision, lane action,
            lane choice, lateral control, lateral motion, our lane, steering wheel, lane keeping,
            lateral command, lane command, lane change, wheel, steering angle, wheel angle,
            steering input, steer angle, steering change, lateral offset, lateral shift
            """
        ),
        "lane",
    ),
}
_SPEED_VALUES = frozenset(
    phrases(
        """
        keep, hold, unchanged, maintain, no change, as is, keep it, hold it, kept, maintained, same,
        same as before, stays the same, stays as it is, leave as is, keep as is, held, unaltered,
        no change needed, same as now, stays, as it is, remains the same, const, constant, steady,
        stable, current, keep current
        """
    )
)
_LANE_VALUES = frozenset(
    phrases(
        """
        keep, hold, unchanged, stay, no change, none, same, as is, straight, keep it, kept, same as
        before, stays the same, leave as is, maintain, neutral, zero, no change needed, nil, held,
        no steering, no input, stays as it is, not needed, none needed, none required, straight on,
        straight ahead, centered, centred, center, centre, own, current, same lane, own lane,
        current lane, no, not changed, leave straight, keep straight, hold straight,
        leave it straight, 0, 0 deg, 0 degrees, zero degrees, leave it,
        stay straight, stays straight, leave unchanged
        """
    )
)
_KEEPS = (["keep"], ["hold"], ["maintain"])
_CHANGES = {
    **dict.fromkeys(
        phrases(
            "reduce, reduced, lower, slower, down, negative, decrease, reducing, slowing, less"
        ),
        "slow",
    ),
    **dict.fromkeys(
        phrases("increase, increased, higher, faster, up, positive, raise, increasing, more"),
        "accelerate",
    ),
}
_LONGEST = 4


def field_value(words: list[str], at: int, field: str) -> Found | None:
    """The value of an action field that says by itself nothing: hold, none, unchanged, keep.

    Args:
        words: words of the text.
        at: the word after the colon.
        field: the field's slot, or ``speed`` or ``lane`` of FIELDS.
    """
    while at < len(words) and words[at] in ('"', "[", ",", "|"):
        at += 1
    if field == "pace" or (field in ("speed", "lon_action") and words[at : at + 1] not in _KEEPS):
        found = _change(words, at, field)
        if found is not None:
            return found
    speed = field in ("speed", "lon_action")
    if not speed and field not in ("lane", "lat_action"):
        return None
    values = _SPEED_VALUES if speed else _LANE_VALUES
    lemma = "keep_speed" if speed else "keep_lane"
    for stop in range(min(at + _LONGEST, len(words)), at, -1):
        ends = stop == len(words) or words[stop] in _MARKS
        if ends and " ".join(words[at:stop]) in values:
            return lemma, "value", at, stop
    return None


def _change(words: list[str], at: int, field: str) -> Found | None:
    """Speed: lower. Acceleration: negative. Target speed: 0 m/s."""
    word = words[at] if at < len(words) else ""
    after = words[at + 1] if at + 1 < len(words) else "."
    ends = after in _MARKS
    if word in ("0", "zero") and (ends or after in ("m", "km", "kmh", "mph")):
        return ("keep_speed" if field == "pace" else "stop"), "value", at, at + 1
    if not ends:
        return None
    if field == "pace" and word in ("none", "no", "nil"):
        return "keep_speed", "value", at, at + 1
    lemma = _CHANGES.get(word)
    return (lemma, "value", at, at + 1) if lemma else None


def straight(words: list[str], at: int) -> Found | None:
    """wheels straight, steering stays straight, straight wheels, straight on, no steering."""
    word = words[at]
    count = len(words)
    after = words[at + 1] if at + 1 < count else "."
    if word == "straight":
        if after in _WHEELS:
            stop = at + 2
            if words[stop : stop + 1] == ["wheel"]:
                stop += 1
            return "keep_lane", "noun", at, stop
        before = words[at - 1] if at else "."
        alone = before in _MARKS or before in ("go", "and")
        ends = at + 2 >= count or words[at + 2] in _MARKS
        if words[at + 1 : at + 3] == ["it", "is"]:
            return "keep_lane", "value", at, at + 3
        named = (before in _COURSES or words[at - 2 : at - 1] in _COURSE) and after in (
            "ahead",
            "on",
        )
        if (before in _COURSES or words[at - 2 : at - 1] in _COURSE) and (
            before in _COURSES or before in ("is", "remains", "stays", "leave", "kept")
        ):
            return "keep_lane", "value", at, at + 1 + named
        if named or (after in _THROUGH and alone and ends):
            return "keep_lane", "value", at, at + 2
        return None
    if word == "no" or word == "zero":
        return _no_steering(words, at)
    if word in _COURSES or word == "lane":
        if words[at + 1 : at + 4] == ["stays", "the", "same"]:
            return "keep_lane", "noun", at, at + 4
        if after in _UNCHANGED and (at == 0 or words[at - 1] in _MARKS or words[at - 1] == "and"):
            return "keep_lane", "noun", at, at + 2
        if word == "lane":
            return _lane_kept(words, at)
        if word not in _WHEELS:
            return None
    here = at + 1
    while here < min(at + 6, count) and words[here] in _HELD:
        here += 1
    if here < count and words[here] in _NEUTRAL:
        return "keep_lane", "noun", at, here + 1
    return None


def _lane_kept(words: list[str], at: int) -> Found | None:
    """The lane is held too; lane is kept."""
    here = at + 1
    while here < min(at + 5, len(words)) and words[here] in _PASSIVE:
        here += 1
    kept = here < len(words) and here > at + 1 and words[here] in ("kept", "held", "maintained")
    return ("keep_lane", "noun", at, here + 1) if kept else None


def _no_steering(words: list[str], at: int) -> Found | None:
    here = at + 1
    count = len(words)
    if words[here : here + 1] == ["change"] and words[here + 1 : here + 2] in (["of"], ["in"]):
        named = words[here + 2 : here + 3] in _DIRECTIONS
        return ("keep_lane", "noun", at, here + 3) if named else None
    sideways = False
    while here < min(at + 5, count):
        word = words[here]
        if word in _STEERING:
            stop = here + 1
            if words[stop : stop + 1] and words[stop] in ("input", "needed", "required", "wheel"):
                stop += 1
            after = words[stop] if stop < count else "."
            return ("keep_lane", "noun", at, stop) if after not in ("to", "towards") else None
        if sideways and word in _MOVES:
            return "keep_lane", "noun", at, here + 1
        if word not in _NO_STEERING:
            return None
        sideways = sideways or word in _SIDEWAYS
        here += 1
    return None
