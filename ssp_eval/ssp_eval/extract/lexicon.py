"""The words and phrases that the rules know, as data: places, states, conflicts, fields.

Road users stand in nouns.py, grammar in grammar.py, verbs in verbs.py. Phrases are
given in the words of stage 1: lower case, hyphens as spaces, ``not`` for n't. Of phrases that
start at the same word the longest wins; a phrase stands in one table only.
"""

from __future__ import annotations

Table = dict[str, tuple[str, ...]]


def phrases(text: str) -> tuple[str, ...]:
    """The phrases of a comma-separated list."""
    return tuple(" ".join(phrase.split()) for phrase in text.split(","))


_SENSIBLE = phrases(
    """
    necessary, best, advisable, required, appropriate, sensible, safest, safer, prudent, wise,
    reasonable, better, right, recommended, advised, essential, enough, sufficient, important,
    mandatory, correct, preferable, imperative, time, smart, fine, good, wisest, smarter
    """
)
# Look like road users or actions and are none.
SKIPPED = (
    *(f"it {be}{adjective} to" for adjective in _SENSIBLE for be in ("is ", "")),
    *phrases(
        """
    it makes sense to, makes sense to, it pays to, it suffices to,
    release the brake,
    release the brakes, releasing the brake, releasing the brakes, off the brake, off the brakes,
    brake pulse, brake pedal, the next, for next, next seconds, next few seconds, until then,
    till then, at once, all at once, as we are, as we do, than we are, than we do, as i am,
    than us, as us, like us, like we do, hazard lights, hazard light, hazard flashers, hazards on,
    hazard flasher, hazard signs, hazard warning lights, risk assessment, conflict zone,
    danger sign, danger zone, conflict point, hazard warning, either way, in either case,
    on either side, either side, stop arm, bicycle symbol, bike symbol, bike stand, bike stands,
    bicycle stand, bicycle stands, cycle stand, cycle stands, motorcycle stand, pedestrian sign,
    bicycle sign, cyclist sign, cycle crossing, red light runner, red light runners,
    taken from a vehicle, taken from a car, taken from inside a car, seen from a car,
    seen from a vehicle, captured from a vehicle, captured from a car, recorded from a car,
    from a moving vehicle, from a moving car, dashcam of a car, human driver, human drivers,
    its cab, the cab of, cab of the, road user, road users, right turn only, left turn only,
    right turn lane, left turn lane, right turn lanes, left turn lanes, right turn pocket,
    left turn pocket, right turn signal, left turn signal, right turn arrow, left turn arrow,
    left turning, right turning, left turn bay, bus stop, bus stops, bus lane, bus lanes,
    bus station, bus shelter, bus bay, bike lane, bike lanes, bicycle lane, bicycle lanes,
    cycle lane, bike path, bicycle path, cycle path, bike rack, bike box, cyclist lane,
    truck lane, truck stop, car park, car parks, car door, car lane, car wash, taxi stand,
    taxi rank, pedestrian crossing, pedestrian crossings, pedestrian crosswalk,
    pedestrian crosswalks, pedestrian signal, pedestrian light, pedestrian lights,
    pedestrian signals, pedestrian bridge, pedestrian area, pedestrian zone, pedestrian path,
    pedestrian traffic, pedestrian walkway, pedestrian activity, pedestrian island,
    pedestrian refuge, pedestrian traffic light, vehicle traffic, vehicle speed, vehicle speeds,
    vehicle control, vehicle dynamics, vehicle motion, vehicle state, child seat,
    construction vehicle, construction vehicles, side by side, bumper to bumper,
    one by one, little by little, step by step, by far, close by,
    two wheeled vehicle, emergency services,
    motorcycle lane, lane for cars, rail car, street car, cable car, worker sign, children sign,
    car length, car lengths, stop sign, stop signs, stop line, stop lines, stop light,
    stop lights, stop bar, stop and go, stopping distance, braking distance, brake light,
    brake lights, braking lights, yield sign, yield signs, yield line, turn lane, turn lanes,
    turn signal, turn signals, turn only, turn pocket, turn arrow, turn bay, turning lane,
    turning lanes, turn indicator, right of way, right now, right away, right angle, right angles,
    right after, right next, all right, right here, right there, merge lane, merging lane,
    merging traffic, merge sign, parking lane, parking lot, parking space, parking spaces,
    passing lane, slow traffic, slow lane, slow zone, speed limit, lane change maneuver ahead,
    no entry, no parking, no stopping, no overtaking sign, no overtaking, not only, no matter,
    no turn, of course, crossing sign, zebra crossing, level crossing, railway crossing,
    rail crossing, crossing point, crossing area, school crossing, crossing lines, stop request,
    shift gear, change in speed, lane change signal, straight line, straight road, straight lane,
    straight section, straight ahead lane, straight stretch, curve to the left,
    curve to the right, curves to the left, curves to the right, curves left, curves right,
    bends left, bends right, bends to the left, bends to the right, left curve, right curve,
    left bend, right bend, bend to the left, bend to the right, curving left, curving right,
    curving to the left, curving to the right, turns yellow, turns red, turns green, turned green,
    turned red, turning red, turning yellow, turning green, turn red, turn green, turn yellow,
    had better, d better, trajectory correction, course correction,
    after about, after roughly, after approximately, after around, i'd say, i would say,
    i'd conclude, i would conclude, i'd call it, i would call it, i'd call this, i'd rate it,
    i'd judge, i would judge, i'd estimate, i'd describe, i'd classify, i'd regard, i'd guess,
    strongly as possible, hard as possible, gently as possible, smoothly as possible,
    quickly as possible, fast as possible, soon as possible, far as possible, much as possible,
    early as possible, only possible, best possible, maximum possible, as possible,
    will be fine, can be seen, can see, could see, may i, moving forward, move forward,
    moves forward
    """
    ),
)

EGO = phrases(
    """
    ego, ego vehicle, ego car, ego agent, ego truck, we, i, us, me, our vehicle, our car, our
    own vehicle, our own car, my vehicle, my car, my own car, the vut, vut, vehicle under
    test, the vehicle under test, host vehicle, host car, own vehicle, own car, self driving
    car, self driving vehicle, autonomous vehicle, autonomous car, automated vehicle, av, the
    av, subject vehicle, your vehicle, your car, you, myself
    """
)

# What a position is relative to when it is relative to the ego: ahead of us, our, the ego.
EGO_WORDS = frozenset(phrases("autonomous, ego, host, me, my, our, own, us, vut, you, your"))

# Nouns that can be the subject of a clause and are no road user.
SCENE = phrases(
    """
    road, lane, lanes, light, lights, signal, crosswalk, intersection, street,
    junction, path, curve, sign, signs, traffic, cone, cones, speed, gap, distance,
    picture, image, weather, sun, sky, trees, buildings, building, tram, trams, animal, dog,
    cat, deer, debris, traffic light, traffic lights, lane markings, sidewalk, scene,
    environment, roadway, train, visibility, surface, trajectory, curvature, curvatures,
    oncoming lane, oncoming lanes, oncoming traffic, oncoming side, oncoming carriageway, opposing
    traffic, opposing lane, opposing lanes, opposite lane, oncoming
    headlights, parallel street, parallel road, parallel track, parallel parking,
    speeds, driveway, corner, shoulder, barrier, barriers, construction, work zone, roundabout
    """
)

_CORNER_PREPS = ("", "in ", "at ", "on ", "to ", "in the ", "at the ", "on the ", "to the ", "our ",
                 "to our ", "on our ", "at our ")  # fmt: skip
_CORNERS = {"front": ("front", "ahead", "forward", "upper"), "rear": ("rear", "behind", "back")}


def _corner(end: str, side: str) -> tuple[str, ...]:
    pairs = ((side, one) if swapped else (one, side) for one in _CORNERS[end]
             for swapped in (False, True))  # fmt: skip
    return tuple(" ".join(pair) for pair in pairs if pair not in {(side, "behind"), (side, "back")})


# Fixed positions; "of X" behind them is looked at by directions.py.
PLACES: Table = {
    "front": phrases(
        """
        ahead, up ahead, directly ahead, just ahead, in front, directly in front, right in
        front, right ahead, immediately ahead, immediately in front, straight in front, up front,
        front, at the front, to the front, further ahead, farther ahead, dead ahead, in
        the front, straight ahead, at front, on front, at the front side, front side, infront,
        in the front side, before us, down the road, in front side, in our front, just before us,
        before our car, just before our car, before our vehicle, just before our vehicle, before
        the ego vehicle, just before the ego vehicle, before our bumper, in front of our bumper,
        before our bonnet, right before us, right before our car, before the ego car
        """
    ),
    "rear": phrases(
        """
        behind, directly behind, right behind, rear, at the rear, in the rear, to the rear,
        immediately behind, close behind, just behind, at the back, at our back, on our tail,
        from behind us, from behind the ego
        """
    ),
    **{
        f"{end}_{side}": (
            *(
                f"{prep}{pair}"
                for prep in _CORNER_PREPS
                for pair in _corner(name, side)
                if prep or pair != "right ahead"
            ),  # which is straight ahead
            *(f"{name} {link} {side}" for name in names for link in ("and", "and to the")),
            *(f"{name} to the {side}" for name in names),
        )
        for end, name, names in (
            ("front", "front", ("ahead", "front")),
            ("rear", "rear", ("behind", "rear")),
        )
        for side in ("left", "right")
    },
}

# Before a noun: "the lead vehicle" is in front.
LEADING = phrases("lead, leading, preceding")

STATES: Table = {
    "stationary": phrases(
        """
        stationary, motionless, at a standstill, at rest, not moving, immobile, broken down,
        disabled, at a stop, at a halt, standing still, stands still, not move, not moved, unmoving,
        stock still, standstill, not moving at all, sitting still, stuck, engine off,
        not yet moving,
        boarding passengers, loading, unloading, picking up passengers, taking on passengers,
        letting passengers off, dropping off passengers, letting passengers out, still boarding,
        not going anywhere, going nowhere, rooted to the spot, no movement, without moving,
        without movement, not in motion, zero speed, lying on the road, stranded, immobilised,
        immobilized, frozen, come to rest, come to a standstill, come to a halt, come to a stop
        """
    ),
    "oncoming": phrases(
        """
        oncoming, in the opposite direction, in opposite direction, from the opposite
        direction, in the oncoming direction, in the opposing direction, opposite direction, facing
        us, from the oncoming direction, opposing, going the opposite way, the other way towards us,
        going the other way, against our direction, against our direction of travel, wrong way,
        driving the wrong way, in the wrong direction, against traffic, against the traffic,
        in the other direction, from the other direction, coming the other way, head on towards us,
        contraflow, on the wrong side of the road
        """
    ),
    "same_direction": phrases(
        """
        in the same direction, same direction, slow moving, in our direction of travel,
        in our direction, moving in parallel, in parallel, parallel, parallel to us,
        parallel with us, parallel to the ego, same way, same way as us, same dir,
        same direction as us, in our driving direction, slower moving, moving parallel,
        along with us, same heading, at equal speed, at an equal speed, at our speed,
        at about our speed, at roughly our speed,
        at the same speed as us, at the same speed as we do, at a similar speed, at similar speed,
        same speed as us, at our pace, at the same pace as us, keeping pace with us, keeps pace with
        us, keeping pace, keeps pace, matching our speed, matches our speed, at nearly our speed,
        at the same speed as ours, at approximately our speed, same direction of travel, at almost
        our speed, at the speed of the ego, moving with us, parallel with the ego,
        parallel to our lane, in the direction of travel
        """
    ),
    "parked": phrases(
        """
        parked, double parked, locked to, locked up, leaning against, leaning on, chained to,
        illegally parked, parked up, parked illegally
        """
    ),
    "receding": (
        *phrases("receding, faster than we are, faster than us, well clear ahead, opening the gap"),
        *(
            f"{noun} {verb}"
            for noun in ("gap", "distance", "headway")
            for verb in phrases(
                """
                keeps growing, is growing, grows, is increasing, increases, keeps increasing,
                is widening, widens, keeps widening, is opening, opens, grew, has been growing,
                opens up, is opening up, gets larger, gets bigger, is getting larger,
                is getting bigger
                """
            )
        ),
    ),
}

RISK = phrases(
    """
    risk, risks, risk of collision, collision risk, hazard, hazards, threat, threats, danger,
    dangers, conflict, conflicts, collision, crash, potential conflict, potential hazard,
    potential collision, potential risk, potential danger, potential threat, possible
    conflict, possible collision, possible hazard, potential hazards, potential conflicts,
    danger of collision, collision hazard, conflict risk, crash risk, risk of a collision,
    risk of conflict, potential collision risk, potentially dangerous, potentially hazardous,
    potentially conflicting, collision threat, collision danger, danger of a collision, risk
    of hitting, potential for conflict, potential for a conflict, potential for a collision,
    potential for collision, risk of a conflict, potentially conflicts
    """
)
# Alone these say that a risk exists; of the rest ("collision", "conflict") only a denial counts.
RISK_ALONE = frozenset(
    phrase
    for phrase in RISK
    if phrase.split()[0].startswith(("risk", "potential", "possible", "danger", "hazard", "threat"))
    or phrase.split()[-1] in ("risk", "hazard", "threat", "danger")
)

CONFLICTS: Table = {
    "active": phrases(
        """
        collision course, course for a collision, heading for a collision, headed for a collision,
        crash course, about to collide, going to collide, bound to collide, heading for a crash,
        immediate danger, acute danger, immediate risk, acute risk, imminent danger, acute conflict,
        immediate conflict, acute collision risk, imminent, active conflict, conflict is active,
        imminent collision, imminent conflict, immediate collision risk
        """
    ),
    "potential": phrases(
        """
        potential one, possible one, not be ruled out, not be excluded, not rule out, not exclude,
        not be discounted
        """
    ),
    "no_conflict": phrases(
        """
        harmless, not get in our way, not in our way, not be in our way, not block our way, no
        conflict, not in conflict, not a concern, conflict free, not concern us, no impact on our,
        no impact on us, no effect on us, no effect on our, not dangerous, risk free
        """
    ),
    "resolved": phrases(
        """
        conflict is resolved, conflict has been resolved, conflict resolved, risk is over,
        danger is over, danger has passed, risk has passed, conflict is over, hazard has
        passed, threat has passed, conflict has passed, resolved, conflict has ended, risk
        has ended, out of danger, conflict has been cleared, conflict has cleared, clear
        of our lane, clear of our path, clear of the road, clear of my lane, clear of my
        path, out of our lane now, out of our path now, path clear again, path is clear again,
        path is free again, path free again, road is clear again, road is free again,
        road clear again, lane is free again, lane is clear again, lane clear again,
        way is clear again, way is free again, lane free again, way clear again, cleared our lane,
        cleared our path, cleared our way, cleared my lane, cleared my path, cleared the road,
        cleared the lane, cleared the crosswalk, cleared the crossing, cleared the carriageway,
        cleared the roadway, cleared the ego lane, cleared the ego path
        """
    ),
}
