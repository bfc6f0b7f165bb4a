"""What names the ego, and nouns that are no road user, as data."""

from __future__ import annotations

from ssp_eval.extract.rules.words.notation import phrases

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
