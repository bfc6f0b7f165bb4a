"""The short values of action fields, and the looser names of such fields.

Speed: hold. Acceleration: negative. Steering: none.
"""

from __future__ import annotations

from ssp_eval.extract.rules.free_phrases.found import ENDS, Found
from ssp_eval.extract.rules.words.notation import phrases

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
        ends = stop == len(words) or words[stop] in ENDS
        if ends and " ".join(words[at:stop]) in values:
            return lemma, "value", at, stop
    return None


def _change(words: list[str], at: int, field: str) -> Found | None:
    """Speed: lower. Acceleration: negative. Target speed: 0 m/s."""
    word = words[at] if at < len(words) else ""
    after = words[at + 1] if at + 1 < len(words) else "."
    ends = after in ENDS
    if word in ("0", "zero") and (ends or after in ("m", "km", "kmh", "mph")):
        return ("keep_speed" if field == "pace" else "stop"), "value", at, at + 1
    if not ends:
        return None
    if field == "pace" and word in ("none", "no", "nil"):
        return "keep_speed", "value", at, at + 1
    lemma = _CHANGES.get(word)
    return (lemma, "value", at, at + 1) if lemma else None
