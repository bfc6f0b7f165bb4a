"""Verbs as data: what the ego does with them. Those of somebody else stand in others_verbs.py."""

from __future__ import annotations

from itertools import product

from ssp_eval.extract.rules.words.notation import phrases

_STICKING = "stick to, adhere to, preserve, retain"
_OWN = (
    "our, the, my, its, our current, the current, the same, its current, the present, our own, own"
)


def _sideways(side: str) -> tuple[tuple[str, str], ...]:
    """A leftward offset, a left correction; take the left lane."""
    nouns = "offset, nudge, shift, move, movement, deviation, correction, displacement, adjustment"
    lanes = (f"{verb} the {side} lane" for verb in ("take", "use", "choose", "occupy"))
    return (
        *((f"{kind} {noun}", "noun") for kind in (side, f"{side}ward", f"{side}wards")
          for noun in phrases(nouns)),
        *((phrase, "base") for phrase in lanes),
    )  # fmt: skip


def _to_keep(things: str) -> tuple[str, ...]:
    """Stick to our lane, preserve the current speed."""
    parts = product(phrases(_STICKING), phrases(_OWN), phrases(things))
    return tuple(" ".join(words) for words in parts)


# lemma: verbs that mean it, as "base particle" with irregular forms given as base|s|ing|ed.
VERBS: dict[str, tuple[str, ...]] = {
    "slow": phrases(
        """
        slow down, decelerate, slow, ease off, back off, coast, give way, deccelerate, decelarate,
        decel, lift off, ease up, drop back, fall back, go slower, drive slower, deaccelerate,
        hang back, slack off, ease back, throttle back, let off, freewheel
        """
    ),
    "keep_speed": _to_keep("speed, pace, velocity"),
    "keep_lane": (
        *_to_keep("lane, line, course, heading"),
        *phrases(
            """
            stay on course, hold course, keep course, maintain course, stay on our course, keep our
            line, hold our line, keep our course, hold our course, keep heading, keep our heading,
            maintain heading, hold heading, keep the heading, keep direction, maintain direction,
            keep the direction, maintain the direction, hold the direction, maintain our heading,
            stay on our line, keep the course, maintain the heading, hold the heading
            """
        ),
    ),
    "brake": phrases("brake"),
    "yield": phrases("yield"),
    "reduce": phrases(
        """
        reduce speed, reduce our speed, reduce my speed, reduce its speed, reduce the
        speed, lower speed, lower our speed, lower my speed, reduce our pace, decrease
        speed, decrease our speed, decrease my speed, reduce velocity, let off the gas,
        let off the accelerator, lift off the accelerator, drop speed, reduce our
        velocity, ease off the accelerator, ease off the gas, release the accelerator, cut
        our speed, cut speed, cut my speed, decrease the speed, decrease its speed
        """
    ),
    "stop": phrases(
        """
        pull to a stop, pull up behind, pull up before, pull up at, stop, halt, |comes to a
        stop|coming to a stop|came to a stop, |comes to a halt|coming to a halt|came to a halt,
        |comes to a standstill|coming to a standstill|came to a standstill, come to a full stop,
        come to a complete stop, come to a complete halt, make a full stop, make a complete stop,
        brake to a stop, slow to a stop, decelerate to a stop, hold pos, hold position, hold our
        position, hold my position, hold its position, remain stopped, stay stopped, remain
        stationary, stay stationary, brake to a halt, brake to a standstill, bring the car to a
        stop, slow to a halt, bring the vehicle to a stop, perform an emergency stop, make an
        emergency stop, decelerate to a full stop, brake to a full stop, stand still|||stood still,
        remain at a standstill, come to a controlled stop, come to a smooth stop
        """
    ),
    "rest": phrases("remain in place, stay in place, sit tight, wait in place"),
    "wait": phrases("wait, stand"),
    "park": phrases("park|parks|parking"),
    "stall": phrases("stall, idle, be stuck|is stuck|being stuck|been stuck"),
    "accelerate": phrases(
        """
        accelerate, accel, acelerate, speed up, go faster, drive faster, get moving, get going,
        start off, move away from standstill, throttle up, resume speed,
        resume our speed, resume normal speed, resume
        my speed, set off, increase speed, increase our speed, increase my speed, pick up
        speed, gain speed, move off, start moving, resume its speed, speed back up, resume
        cruising speed, regain speed, increase the speed, increase its speed, resume our
        normal speed, resume the speed, resume the original speed, resume the previous
        speed, resume target speed, resume driving, resume motion, resume movement, resume our
        journey, resume travel, restart, get back up to speed, get back to speed, come back up to
        speed, get rolling, start rolling, start driving, start to move, begin to move, begin
        moving, start again, get under way, start from standstill, start from rest, step on the gas,
        put the foot down, put our foot down, put my foot down, give gas, give some gas, add speed,
        resume the journey, start to drive, begin to drive, begin driving, begin to roll
        """
    ),
    "cruise": phrases("cruise"),
    "steer": phrases(
        """
        steer, nudge, shift, swerve, veer, drift, edge, bear, deviate, offset, divert, dodge,
        evade, sidestep, sidle, swing, slide, inch, veer off, lean
        """
    ),
    "turn": phrases(
        """
        turn, make a|makes a|making a|made a, take a|takes a|taking a|took a, perform
        a|performs a|performing a|performed a, execute a|executes a|executing a|executed
        a, initiate a|initiates a|initiating a|initiated a
        """
    ),
    "merge": phrases("merge"),
    "change": phrases(
        """
        change lane, change lanes, switch lane, switch lanes, change into,
        change to|changes to|changing to,
        switch to, switch into, change over, switch over
        """
    ),
    "move": phrases(
        """
        move, pull over, pull, go, move over, shift over, squeeze||squeezing|squeezed, head, come,
        get over, pull out, swing out, go over, move across, steer over, cross over, make room, give
        room, give space
        """
    ),
    "drive": phrases("drive, travel, proceed, ride, progress"),
    "open": phrases(
        """
        open, hit us, hit me, hit the ego, strike us, |||collided with us, |||collided with me,
        collide, fall, ||appearing|appeared, react, lose control
        """
    ),
    "continue": phrases("start, begin, continue"),
}

EXTRA_FORMS: dict[str, tuple[tuple[str, str], ...]] = {
    "drive": (("travelling", "ing"), ("travelled", "ed")),
    "slow": (("deceleration", "noun"), ("slowdown", "noun"), ("give right of way", "base")),
    "brake": (
        ("hard braking", "noun"),
        ("emergency braking", "noun"),
        ("brake application", "noun"),
        ("light brake application", "noun"),
        ("light braking", "noun"),
        ("slight braking", "noun"),
        ("soft braking", "noun"),
        ("full braking", "noun"),
        ("braking manoeuvre", "noun"),
        ("braking maneuver", "noun"),
        ("apply brakes", "base"),
        ("apply the brakes", "base"),
        ("applying the brakes", "ing"),
        ("press the brake", "base"),
        ("hit the brakes", "base"),
        ("gentle braking", "noun"),
        ("apply gentle braking", "base"),
        ("apply moderate braking", "base"),
    ),
    "reduce": (
        ("speed reduction", "noun"),
        ("reduction of speed", "noun"),
        ("reduction in speed", "noun"),
        ("reduction of our speed", "noun"),
        ("reduction in our speed", "noun"),
        ("reduction of the speed", "noun"),
        ("reduction in the speed", "noun"),
        ("decrease in speed", "noun"),
        ("decrease of speed", "noun"),
    ),
    "keep_speed": (
        ("no change of speed", "noun"),
        ("no change in speed", "noun"),
        ("without changing speed", "noun"),
        ("no speed change", "noun"),
    ),
    "stop": (
        ("a stop is necessary", "noun"),
        ("a stop is required", "noun"),
        ("a stop is needed", "noun"),
        ("full stop", "noun"),
        ("complete stop", "noun"),
        ("emergency stop", "noun"),
    ),
    "accelerate": (("acceleration", "noun"),),
    "change": (("lane change", "noun"), ("lane changing", "noun")),
    "change_left": (
        ("change lanes left", "base"),
        ("change lane left", "base"),
        ("turn left", "base"),
        ("turning left", "ing"),
        ("turns left", "s"),
        ("lane change left", "noun"),
        ("left lane change", "noun"),
        ("left turn", "noun"),
        *_sideways("left"),
        ("left turns", "noun"),
        ("left merge", "noun"),
        ("turned left", "ed"),
        ("change left", "base"),
        ("changing left", "ing"),
        ("shift leftward", "base"),
        ("steer leftward", "base"),
        ("keep left", "base"),
    ),
    "change_right": (
        ("change lanes right", "base"),
        ("change lane right", "base"),
        ("turn right", "base"),
        ("turning right", "ing"),
        ("turns right", "s"),
        ("lane change right", "noun"),
        ("right lane change", "noun"),
        ("right turn", "noun"),
        *_sideways("right"),
        ("right turns", "noun"),
        ("right merge", "noun"),
        ("turned right", "ed"),
        ("change right", "base"),
        ("changing right", "ing"),
        ("shift rightward", "base"),
        ("steer rightward", "base"),
        ("keep right", "base"),
    ),
    "keep_lane": (
        ("lane keeping", "noun"),
        ("without steering", "noun"),
        ("keep lane", "base"),
        ("lane keep", "noun"),
        ("keeping lane", "ing"),
        ("no lateral movement", "noun"),
        ("no lateral action", "noun"),
        ("keep the steering straight", "base"),
        ("lane follow", "noun"),
        ("keep the wheel straight", "base"),
        ("keep steering straight", "base"),
    ),
}

LON_ACTIONS = {
    "slow": "decelerate",
    "brake": "decelerate",
    "yield": "decelerate",
    "reduce": "decelerate",
    "stop": "stop",
    "rest": "stop",
    "accelerate": "accelerate",
    "cruise": "maintain",
    "keep_speed": "maintain",
}
# The direction stands in the verb, or beside it (steer, nudge … left).
LAT_ACTIONS = {"change_left": "left", "change_right": "right", "keep_lane": "straight"}
STEERING = frozenset({"steer", "turn", "merge", "change", "move", "cut_in"})
