"""What a text says to matter, or not to, and whom a plan is about, as data."""

from __future__ import annotations

from ssp_eval.extract.rules.hits import Kind
from ssp_eval.extract.rules.words.notation import Table, phrases

KINDS: dict[Kind, Table] = {
    Kind.CRITICAL: {
        "": phrases(
            """
            critical, critical object, critical objects, notable object, notable objects,
            pay attention to, paying attention to, watch, watching, monitor, monitoring,
            key object, key objects, attention to, keep an eye on, keeping an eye on, important,
            relevant, be aware of, aware of, main object, relevant object, relevant objects,
            most critical, focus on, critical road user, critical road users, object of interest,
            objects of interest, be careful of, mind, observe, observing, relevant road user,
            relevant road users, important object, important objects, main hazard,
            must be watched, needs to be watched, should be watched, to be watched,
            needs attention, requires attention, deserve attention, deserves attention,
            deserves our attention, attend to, who counts, what counts, conflict partner,
            main concern, primary concern, my concern is, of concern, biggest concern, must watch,
            key road user, key road users, primary object, most relevant, that matters,
            that matter, of note, noteworthy, the hazard is, key agent, key agents,
            object of attention, objects of attention, needs watching, worth watching,
            bears watching, be monitored, be observed, kept in mind, stands out, main actor,
            deserve our attention, merits attention, calls for attention, most dangerous,
            object to watch, objects to watch, matters most, the one that counts, vital,
            of relevance, safety critical, most important, decisive, object to be careful about,
            keep track of, keeping track of, main threat, biggest threat, most pressing,
            critical agent, critical agents
            """
        ),
    },
    Kind.BACKGROUND: {
        "it": phrases(
            """
            skip it, leave it out, leave them out, leave him out, leave her out, skip them, not
            count it, not count them, not list it, not list them, drop it, ignore it, ignore them,
            skip him, skip her, disregard it, disregard them, leave it aside

            """
        ),
        "gone": phrases(
            """
            gone, is gone, are gone, out of view, out of sight, out of the picture, no longer
            visible, no longer in view, no longer in sight, not be seen anymore, has left at, left
            the scene, disappeared from view, vanished, nowhere to be seen, has gone, driven past
            us already

            """
        ),
        "": phrases(
            """
            visible too, is also visible, visible as well, also visible, also present,
            also in view, seen as well, seen too, background, irrelevant, not relevant,
            of no interest, no attention, no relation to, as background, part of the background,
            no role, not play any role, plays no part, not count, not list, not listed,
            not a matter for us, not our business, not part of, opposite carriageway,
            other carriageway, opposing carriageway, side alley, not involved,
            nothing to do with us, of no consequence, disregard, disregarded, can be disregarded,
            be ignored, may be ignored, ignored, not of concern, not concern, no significance,
            of no significance, no bearing, not significant, not of importance, not considered,
            unimportant, of low relevance, no threat to us, skip, not critical as such,
            without a rider, have no riders, without riders, no rider, separated from us,
            set back from, can be ignored, not matter, not important, negligible, far away,
            unrelated, of no importance, not critical, ignore, ignoring, of no concern,
            no relevance, not of interest, in the distance, of no relevance, off the road
            """
        ),
    },
    Kind.MATTERS: {
        "by": phrases(
            """
            blocked by, hidden behind, occluded by, hidden by, obstructed by, concealed by,
            concealed behind, screened by, masked by, from behind a, from behind the,
            from behind the stopped, from between, covered by, obscured by,
            occluded behind, behind the parked, between the parked, behind a parked,
            between parked, behind parked
            """
        ),
        "": phrases(
            """
            obstacle, obstacles, obstruct, obstructs, obstructing, obstruction, block, blocks, hid,
            has hid, has hidden,
            blocking, hide, hides, hiding, conceal, conceals, concealing, occlude, occludes,
            occluding, obscures, obscuring, screens, masks, narrows, narrowing, encroaches,
            encroaching, squeezes, reduces our clearance, protrudes, protruding, limits our view,
            limiting our view, blocks our view, in our way, in the way, hinder, hinders, hindering,
            hamper, hampers, hampering, impede, impedes, impeding, thwarts, thwarting, precludes,
            precluding
            """
        ),
    },
    Kind.REACT: {
        "": phrases(
            """
            clearance, clearance from, clearance to, distance to, distance from, gap
            to, safe distance, gap from, follow, following, overtake, overtaking,
            around, space to, room for, space for, make way for, room to, wait for,
            waiting for, headway to, close to, away from, collide with, colliding
            with, hit, hitting, distance behind, pass, passing, distance with
            """
        ),
    },
    Kind.NOBODY: {
        "": (
            *phrases(
                """
                nobody, no one, noone, nobody else, no one else, no vehicles or people, no vehicles
                or pedestrians, no vehicles nor pedestrians, no vehicles and no pedestrians, no
                pedestrians or vehicles, no pedestrians or other vehicles, no other vehicles or
                pedestrians, no pedestrians and no vehicles, road is empty, street is empty, road
                ahead is empty, empty road, street is deserted, road is deserted, deserted road,
                pavements are empty, no cars or people, no cars or pedestrians, nobody around
                """
            ),
            *(
                f"{none} {who}"
                for none in phrases(
                    """
                    no, no other, no visible, no relevant, no critical, zero, without, without any,
                    free of, free of other, not any, not any other, any other, no notable, devoid of
                    any, free of any, absence of, devoid of, no single, not a single, no nearby, no
                    important, no active, no such, not see any, not see any other, not detect any,
                    not notice any, not observe any, not spot any, not identify any, are not any
                    """
                )
                for who in phrases(
                    """
                    road users, road user, traffic participants, traffic participant, agents, agent,
                    objects, object, actors, actor, critical objects, relevant objects, critical
                    object, relevant object, road users or obstacles, critical road users, relevant
                    road users, road participants, dynamic objects, moving objects, notable objects,
                    key objects, dynamic agents, traffic agents
                    """
                )
                if none != "any other"
            ),
            *(
                f"no {who} {join} {others}"
                for who in phrases("pedestrians, vehicles, cars, cyclists, people, persons")
                for join in ("or", "and", "nor")
                for others in phrases("other road users, other traffic participants, other agents")
            ),
        ),
    },
}
