"""The nouns that name road users, as data, and those that only two nouns together name.

A man on a bicycle is a cyclist, a man who pushes one is a pedestrian, a rider of a scooter is a
motorcycle.
"""

from __future__ import annotations

from ssp_eval.extract.rules.words.notation import Table, phrases

_SINGULAR: Table = {
    "car": phrases(
        """
        car, vehicle, vehical, vehicel, automobile, sedan, saloon, suv, van, minivan, taxi,
        pickup, pickup truck, hatchback, cab, jeep, convertible, cabriolet, station wagon,
        estate car, coup, coupe, mpv, people carrier, police car, patrol car, police van,
        delivery van, cargo van, panel van, camper van, campervan, camper, motorhome,
        pick up truck, motor vehicle, motor car, passenger car, passenger vehicle, robotaxi,
        transporter, crossover, roadster, limousine, limo, sports car, sportscar, station waggon,
        delivery vehicle, minicab, city car, compact car, van driver, taxi driver, car driver,
        fiat, bmw, audi, toyota, tesla, volkswagen, vw, mercedes, volvo, nissan, hyundai, kia,
        renault, peugeot, opel, skoda, porsche, mazda, subaru, lexus, ute
        """
    ),
    "truck": phrases(
        """
        truck, lorry, semi, semi truck, tractor trailer, tow truck, garbage truck, box truck,
        dump truck, fire truck, fire engine, delivery truck, semi trailer, articulated lorry,
        tanker, tanker truck, tractor trailer truck, cement truck, cement mixer, trash truck,
        refuse truck, truk, cargo truck, heavy goods vehicle, hgv, big rig, eighteen wheeler,
        flatbed, flatbed truck, milk lorry, bin lorry, refuse lorry, dustcart, juggernaut,
        articulated truck, dumper truck, tipper truck, tipper, freight truck, recovery truck,
        car transporter, car carrier, logging truck, truck driver, lorry driver
        """
    ),
    "bus": phrases(
        """
        bus, coach, school bus, minibus, shuttle bus, city bus, double decker, transit bus,
        double decker bus, tour bus, articulated bus, public bus, bus driver, airport shuttle
        """
    ),
    "motorcycle": phrases(
        """
        motorcycle, motorbike, scooter, motorcyclist, moped, motor bike, motor scooter,
        motorcycle rider, motorbike rider, scooter rider, motor cyclist, moped rider, vespa,
        dirt bike, sports bike, sport bike, motor cycle, biker, scooter driver
        """
    ),
    "cyclist": phrases(
        """
        cyclist, cyclest, bycicle, bicycle, bike, bicyclist, bicycle rider, bike rider,
        cycle rider, e bike, ebike, pushbike, push bike, cargo bike, racing bike, racing cyclist,
        road bike, mountain bike, tricycle, pedal cyclist, pedal cycle, bike courier,
        bicycle courier, cycle courier, bicycle messenger, handcyclist
        """
    ),
    "pedestrian": phrases(
        """
        pedestrian, person, paramedic, fireman, firefighter, medic, nurse, kid, jogger, worker,
        road worker, construction worker, dock worker, wheelchair user, walker, dog walker,
        runner, boy, girl, toddler, crossing guard, adult, passer by, passerby, policeman,
        policewoman, police officer, traffic officer, woman, man, lady, gentleman, guy, dude, lad,
        student, pupil, teenager, teen, youth, schoolboy, schoolgirl, mother, father, mum, dad,
        pensioner, granny, grandmother, grandfather, ped, pedestrain, pedestrians dummy,
        pedestrian dummy, shopper, commuter, tourist, skater, skateboarder, postman, mail carrier,
        road sweeper, flagger, workman, infant, youngster, old man, old woman, old lady, parent,
        stroller pusher, lollipop lady, lollipop man, hiker, flagman, pram pusher, wheelchair
        """
    ),
}
_IRREGULAR = {
    "man": "men",
    "woman": "women",
    "lady": "ladies",
    "lorry": "lorries",
    "taxi": "taxis",
    "child": "children",
    "cab": "cabs",
    "person": "persons",
    "passer by": "passers by",
    "passerby": "passersby",
}
_UNCOMMON: Table = {
    "car": phrases("taxies"),
    "pedestrian": phrases(
        """
        people, child, children, schoolchild, schoolchildren, passers by, folks,
        person in a wheelchair, man in a wheelchair, woman in a wheelchair, someone, somebody
        """
    ),
}


def _plural(noun: str) -> str:
    head, _, last = noun.rpartition(" ")
    if last in _IRREGULAR:
        plural = _IRREGULAR[last]
    elif last.endswith("man"):
        plural = last[:-3] + "men"
    elif last.endswith(("s", "ch", "sh", "x")):
        plural = last + "es"
    elif last.endswith("y") and last[-2] not in "aeiou":
        plural = last[:-1] + "ies"
    else:
        plural = last + "s"
    return f"{head} {plural}" if head else plural


OBJECT_NOUNS: Table = {
    name: (*listed, *map(_plural, listed), *_UNCOMMON.get(name, ()))
    for name, listed in _SINGULAR.items()
}


def plurals() -> dict[str, str]:
    """The last words of all plurals with their singular."""
    found = {"people": "person", "children": "child", "schoolchildren": "schoolchild"}
    for listed in _SINGULAR.values():
        for noun in listed:
            found[_plural(noun).rpartition(" ")[2]] = noun.rpartition(" ")[2]
    return found


_VAGUE = frozenset(phrases("someone, somebody"))
_PRESENT_AFTER = frozenset(
    phrases("is, on, crossing, walking, standing, running, crosses, walks, runs, has, in, stands")
)
NOUNS = frozenset(noun for listed in OBJECT_NOUNS.values() for noun in listed if " " not in noun)
_CYCLES = frozenset(OBJECT_NOUNS["cyclist"])
_MOTORCYCLES = frozenset(OBJECT_NOUNS["motorcycle"])
_MOUNTED = frozenset(phrases("on, riding, rides, aboard, cycling"))
_LEADING = frozenset(phrases("pushing, pushes, walking, wheeling, walks, wheels, with, carrying"))
_ARTICLES = frozenset(phrases("a, an, the, his, her, their, its, two"))
_BREAKS = frozenset(phrases("and, or, from, in, at, to, ahead, is, are, who, has, of"))
MAX_ADJECTIVES = 3
# A noun before one of these names a thing: bike rack, car dealership.
_THINGS = frozenset(
    phrases(
        """
        rack, racks, shop, shops, dealership, depot, terminal, garage, rental, symbol, symbols,
        pictogram, pictograms, logo, marking, markings, shelter, shelters, platform, seat, seats,
        width, route, routes, facility, infrastructure, storage, charger, noise, insurance, model,
        manufacturer, sensor, sensors, camera, cameras, interior, simulator, dashboard, tracks
        """
    )
)
# What a picture is taken from: the windscreen of a car.
_VIEWS = frozenset(
    phrases(
        """
        windshield, windscreen, hood, bonnet, dashboard, dashcam, camera, view, perspective,
        viewpoint, cockpit, taken, recorded, mounted, filmed, captured, shot, seen, footage, seat,
        inside, interior, driver, image, picture, pictures, images, video
        """
    )
)
_VIEWED_FROM = frozenset(phrases("of, from, in, inside, on, within"))


def is_part(words: list[str], at: int, stop: int) -> bool:
    """Whether a noun only says of what kind a thing is, or from where the picture was taken."""
    if stop < len(words) and words[stop] in _THINGS:
        return True
    if at < 3 or words[at] not in ("car", "vehicle", "van", "truck"):
        return False
    first = next((b for b in range(at - 1, at - 4, -1) if words[b] in _VIEWED_FROM), None)
    if first is None or words[first + 1] not in ("a", "the", "moving"):
        return False
    near = words[max(first - 3, 0) : first]
    return words[first + 1] != "the" and not _VIEWS.isdisjoint(near)


def vague(words: list[str], at: int) -> bool:
    """Whether a noun is somebody of whom nothing is said: "hide somebody" names no road user."""
    return words[at] in _VAGUE and (at + 1 == len(words) or words[at + 1] not in _PRESENT_AFTER)


def together(words: list[str], stop: int, name: str) -> tuple[str, int] | None:
    """The class that a noun has with what its bearer rides or pushes, and the word after that.

    Args:
        words: all words.
        stop: word after a noun that names a person, or after a bare "rider".
        name: the noun's own class.
    """
    if stop + 1 >= len(words):
        return None
    link = words[stop]
    if link not in _MOUNTED and link not in _LEADING:
        return None
    here = stop + 1
    if words[here] in _ARTICLES:
        here += 1
    elif link == "with":
        return None
    for end in range(here, min(here + MAX_ADJECTIVES, len(words))):
        word = words[end]
        if word in _BREAKS or not word.isalpha():
            return None
        for length in (2, 1):
            noun = " ".join(words[end : end + length])
            cycle = noun in _CYCLES
            if cycle or noun in _MOTORCYCLES:
                after = end + length
                if link in _LEADING:
                    return (name, after) if cycle else None
                return ("cyclist" if cycle else "motorcycle"), after
    return None
