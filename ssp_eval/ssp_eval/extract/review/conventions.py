"""What counts as what, told to reviewers beside each question."""

from __future__ import annotations

from collections.abc import Mapping

GENERAL = (
    "Answer what the text itself asserts about the present moment, as a careful reader takes it. "
    "You may not add what you know about traffic.",
    "Leave aside what is supposed (if, could), past, denied, rejected, or only quoted: a prompt, "
    "a question, a list of options.",
    "Position, motion and conflict are about one road user, the critical one: whoever the conflict "
    "is with; if nobody is named so, whoever the plan reacts to; else the first that is called "
    "critical. Left and right, ahead and behind are seen from the model's own vehicle.",
    "Choose “none” where the text says nothing about the slot, which is common and no fault. "
    "Choose “unsure” only where you can't decide after a second reading.",
)

ASKED: Mapping[str, str] = {
    "objects": "Which road users are there and matter?",
    "position": "Where is the critical one?",
    "motion": "What does the critical one do now?",
    "conflict": "Is there a conflict with the own vehicle?",
    "lon_action": "What does the own vehicle decide about its speed?",
    "lat_action": "What does the own vehicle decide about its lane or steering?",
}

CONVENTIONS: Mapping[str, str] = {
    "objects": "A class counts if somebody of it is said to be there and to matter: listed as "
    "critical, to be watched, or a reason for the plan. What is called irrelevant or is mere "
    "background doesn't. Vans, taxis, pickups and a plain “vehicle” are cars; lorries are trucks; "
    "coaches are buses; scooters are motorcycles; people on bicycles are cyclists, people on foot "
    "or in a wheelchair pedestrians. Parked vehicles count only if the text says why they matter. "
    "“Traffic”, trams, animals and cones are no class. “nobody” only if the text says that there "
    "is nobody.",
    "position": "In front is “front”, also for a lead vehicle; in front to the left “front_left”; "
    "beside us on the left “left”; behind “rear”. “From the right” tells of a motion, and "
    "coordinates are no words. Of several moments the last counts.",
    "motion": "Crossing and cutting in need the side it comes from, else “none”. Into our lane "
    "from the left, be it by merging or drifting: “cutting_in_from_left”. Out of our lane: "
    "“cutting_out”. Ahead or beside us in our direction, also braking or overtaking: "
    "“same_direction”. Getting further away from us: “receding”. Standing, waiting, parked: "
    "“stationary”. What it may do or is about to do is no motion, and a crossing that is over "
    "isn't one either.",
    "conflict": "May, could, a risk of: “potential”. A collision course, or in our path so that we "
    "must act: “active”. Passed, cleared, no longer a risk: “resolved”. Harmless, doesn't concern "
    "us: “no_conflict”. That somebody crosses and we yield says nothing by itself.",
    "lon_action": "Slow, brake, yield, ease off, coast: “decelerate”. Stop, halt, stay standing, "
    "slow down and stop: “stop”. Keep or hold the speed, cruise: “maintain”. Speed up, resume, set "
    "off: “accelerate”. No decision are: keep the distance, be ready to brake, go on with "
    "caution, either this or that, something under a condition, what is not to be done. A final "
    "plan counts more than an earlier one.",
    "lat_action": "Stay in the lane, no steering: “straight”. Steer, nudge, shift, change lanes, "
    "turn: its side. What is ruled out doesn't decide for the rest. A manoeuvre for later counts "
    "only if there is no other. Following a bend is none.",
}
