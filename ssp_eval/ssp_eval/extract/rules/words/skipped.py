"""Phrases that look like road users or actions and are none, as data."""

from __future__ import annotations

from ssp_eval.extract.rules.words.notation import phrases

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
