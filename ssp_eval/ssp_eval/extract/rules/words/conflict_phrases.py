"""Phrases for risks and conflicts, as data: collision course, out of danger."""

from __future__ import annotations

from itertools import product

from ssp_eval.extract.rules.words.notation import Table, phrases

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

# Of these only a denial counts (no conflict), or a may (potential).
_AFFECTING = phrases(
    """
    affect, affects, affecting, endanger, endangers, endangering, threaten, threatens, threatening,
    hinder, hinders, hindering, impede, impedes, impeding, disturb, disturbs, disturbing, bother,
    bothers, bothering, influence, influences, influencing, impact, impacts, impacting,
    interfere with, interferes with, interfering with, conflict with, conflicts with,
    conflicting with, collide with, colliding with, intersect with, intersects with, intersect,
    intersects, effect on, effect to, effects on, impact on, influence on, danger to, danger for,
    threat to, threat for, risk to, risk for, hazard to, hazard for, harm, harming, overlap with,
    overlaps with, collides with, conflict for, harm to, trouble for, overlapping with,
    problem for, issue for
    """
)
_US = phrases(
    """
    us, me, our path, our lane, our motion, our driving, our plan, our trajectory, my path, my
    lane, our way, our progress, the ego, ego, the ego vehicle, the vut, our course, our route,
    our travel, the ego path, our vehicle, our car, our driving path, our decision, our speed, our
    movement, the ego vehicle path, the ego lane, our planned path, the ego car, my plan, my
    driving, ours, you, your path, your lane, its path, our intended path, our own path, our
    future path

    """
)
AFFECTS = tuple(f"{verb} {whom}" for verb, whom in product(_AFFECTING, _US))
