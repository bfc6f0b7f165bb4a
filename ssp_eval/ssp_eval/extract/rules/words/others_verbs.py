"""Movements of somebody else, as data: verbs that the ego's plan has no use for."""

from __future__ import annotations

from itertools import product

from ssp_eval.extract.rules.words.notation import phrases

_US = phrases("us, me, the ego, the ego vehicle, the ego car, our vehicle, our car, the vut, ego")
_OUR_LANES = phrases(
    """
    our lane, my lane, the ego lane, the lane of the ego, our path, my path, the ego path, our
    own lane, the ego vehicle lane, the lane of travel, ego lane, our driving lane, ours, mine
    """
)


def _with(verbs: str, objects: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{verb} {thing}" for verb, thing in product(phrases(verbs), objects))


# lemma: verbs that mean it, as in ego_verbs.py; a form left out there is something else elsewhere.
MOVEMENTS: dict[str, tuple[str, ...]] = {
    "step": phrases(
        """
        make its way, make his way, make her way, make their way, make the way, set foot, step,
        walk, run, dart, rush, stride, jog, jump, sprint, emerge, wander, stroll, roll, hurry,
        |skips|skipping|skipped, limp, hobble, dash, race, push, wheel, skate, march, totter,
        shuffle, amble, shoot, bolt, scurry, scamper, trot, saunter, stumble, stagger, toddle, hop,
        leap, charge, burst, storm, plod, trudge, tiptoe, crawl out, spring, pop out, come running,
        come walking, come shooting, come flying, come racing, come rushing, come dashing, come
        darting
        """
    ),
    "pedal": phrases(
        """
        pedal, cycle, crawl, creep, trundle, trail, ||biking|biked, filter, glide, zoom, fly, whizz,
        blast, barrel, plough, plow, chug, coast along, weave, zip
        """
    ),
    "cross": phrases("cross, traverse, cut across, slice across, xings||xing|xinged"),
    "enter": phrases("enter, encroach|||encroached, intrude"),
    "cut_in": (
        *phrases(
            """
            cut in, cut into, cut in front, pull in, pull into, move into, swerve into, drift
            into, veer into, steer into, merge into, shift into, squeeze into, push into, push
            in, squeeze in, move in front, pull in front, merge in front, swerve in front, cut
            off, edge into, cut us off, cut me off, cut us up, encroach on, encroach into, intrude
            into, slide into, force its way in, barge in, nose into, squeeze in front, slip in,
            change lanes in front, merge ahead of us, come in front of us, slot in
            """
        ),
        *_with("enter, invade, change into, change to, change lane into, come into, come onto",
               _OUR_LANES),
        *_with("change lanes into, change lanes to, drive into, encroach on, cross into, turn into,"
               "swing into, nudge into, slip into, cross over into, come across into, pull over"
               " into, move over into, come over into, lean into, roll into, creep into, inch into,"
               "steer over into, pull out into, emerge into, pull to, merge to, squeeze to,"
               "merge onto, ease into, dive into, dart into, cut to, jump into, stray into,"
               "wander into, spill into, back into, reverse into", _OUR_LANES),
        *_with("turn out in front of, pull out in front of, swing in front of, slide in front of,"
               "cut across in front of, drift in front of", _US),
    ),
    "cut_out": (
        *phrases("cut out, leave the lane"),
        *_with("leave, exit, vacate, move out of, pull out of, merge out of, change out of",
               _OUR_LANES),
        *_with("drift out of, swerve out of, steer out of, turn out of, quit", _OUR_LANES),
    ),
    "overtake": (
        *_with("overtake, pass, undertake, catch up with, close in on, gain on, creep up on", _US),
        *_with("come up behind, close up behind, pull alongside, draw alongside, draw level with",
               _US),
        *phrases("catch up, closes in||closing in|closed in, draw level"),
        *phrases("pull alongside, come alongside"),
    ),
    "tailgate": (
        *phrases("tailgate, follow closely behind us, follow us closely, ride our bumper"),
        *_with("tailgate, follow, trail", _US),
    ),
    "recede": phrases(
        """
        pull away, recede|recedes||receded, drive away, move away, speed away, drive off, accelerate
        away, go away, speed off, run away, gain distance, ride away, ride off, head away, pull
        ahead, draw away, drift away, disappear, depart
        """
    ),
    "approach": (
        *_with("approach, head for, head straight for, bear down on, drive straight at,"
               "come straight at, head right at, rush at", _US),
        "face us|faces us||faced us",
        *_with("face", _US[1:]),
        *phrases(
            """
            approach from ahead, approach from the front, come from ahead, approach head on, come
            at us, come our way, head our way, drive our way,
            come the other way|comes the other way||came the other way, approach in the
            opposite lane, approach in the oncoming lane, come the opposite way, meet us
            """
        ),
        *(
            f"{verb} {prep} the camera"
            for verb, prep in product(phrases("move, come, drive, head, travel, ride"),
                                      ("towards", "toward"))
        ),
    ),
    "near": phrases("approach, near, come closer, get closer, come up"),
    "come_over": phrases("come over, come across"),
    "clear": (
        *phrases("clear, clear the intersection, exit"),
        *(
            f"clear {what}|clears {what}|clearing {what}"
            for what in phrases("our lane, our path, my lane, my path, the road, the lane,"
                                "the crosswalk")
        ),
    ),
    "pass_by": phrases("|passes||passed, pass by"),
    "leave": phrases(
        """
        leave the road, leave the crosswalk, leave the roadway, leave the street,
        leave the intersection, leave the conflict zone,
        leave the scene|leaves the scene|leaving the scene
        """
    ),
    "finish": phrases(
        """
        finish crossing, complete crossing, finish its crossing, complete its crossing,
        finish their crossing, complete the crossing, finish the crossing, finish passing,
        get across
        """
    ),
    "queue": phrases(
        """
        queue, stay put, pause, linger, loiter, hesitate, squat, freeze|freezes|freezing, lie,
        sit still|sits still||sat still, break down|breaks down|breaking down,
        |comes to rest|coming to rest|came to rest
        """
    ),
    "serve": phrases("unload|unloads||unloaded, load|loads||loaded, board"),
    "sit": phrases("sit"),
    "reach": phrases("reach, arrive at, arrive on, gain, end up on"),
}  # fmt: skip
# What a movement of somebody else is; some need a side or company, see motion/verb_meaning.py.
STANDING = frozenset({"stop", "wait", "park", "stall", "queue", "sit", "rest", "serve"})
MOVING = frozenset(
    {
        "slow",
        "brake",
        "reduce",
        "drive",
        "move",
        "accelerate",
        "cruise",
        "pedal",
        "keep_speed",
        "keep_lane",
    }
)
ALONG = frozenset({"overtake", "tailgate"})
INTO_LANE = frozenset({"merge", "steer", "change", "move", "enter", "step", "pedal", "drive"})
ACROSS = frozenset({"step", "move", "drive", "enter", "pedal"})
CLEARING = frozenset({"clear", "pass_by", "leave", "finish", "cut_out", "cross"})
# May, could … + one of these by somebody else: a potential conflict.
ENDANGERING = frozenset(
    {
        "cross",
        "cut_in",
        "merge",
        "enter",
        "step",
        "steer",
        "move",
        "turn",
        "brake",
        "stop",
        "change",
        "open",
        "slow",
        "change_left",
        "change_right",
        "accelerate",
        "cut_out",
        "come_over",
    }
)
