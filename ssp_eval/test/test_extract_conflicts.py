"""The status of the conflict in its usual wordings (LABELLING.md), class by class."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from extract_tables import holds, score

ACTIVE = [
    "A child is ahead. Without braking we'd hit it.",
    "A van is ahead; we will run into it unless we stop.",
    "If we don't brake we will crash into the truck ahead.",
    "Brake, otherwise there will be contact with the car ahead.",
    "A man stands ahead, the ego must react or it will hit him.",
    "A cyclist is in our path now, we must react.",
    "We have to react: a cyclist is now in our path.",
    "A car is on a collision course with us. It may still swerve.",
    "If we carry on like this we will run him over.",
    "The ego has to swerve, it scrapes the van on the right otherwise.",
    "A man walks ahead of us: unless the car brakes at once it runs him over.",
    "A bus stands ahead, and only hard braking prevents the impact.",
    "The conflict with the jogger ahead is active.",
    "There is an immediate danger of hitting the car ahead.",
    "We are heading for a collision with the bus ahead.",
    "The van cuts in from the left, we must react at once to avoid a collision.",
    "I would say a crash with the truck ahead is imminent.",
]
POTENTIAL = [
    "A boy on the right might step out.",
    "The van on the right could pull out.",
    "SUV on the right, indicator on; might come over.",
    "The cyclist ahead may suddenly swerve.",
    "There might be a cut-in by the car on the right.",
    "Slow down due to a possible cut-in of the taxi on the right.",
    "A parked van ahead on the right may hide somebody.",
    "A truck is ahead; a conflict may develop.",
    "A truck is ahead; we could run into it.",
    "If a child ran out there'd be no time, so this is a potential hazard.",
    "The truck on the right could sideswipe us.",
    "A conflict with the tram and the bus ahead can't be ruled out.",
    "There's a chance that the man on the right steps out.",
    "A boy on the left who potentially runs onto the road.",
    "The car in the driveway ahead might back out.",
    "A contact with the bus on the left is possible.",
    "A tram is ahead, a collision might occur.",
    "A girl waits on the right. Perhaps she runs.",
    "A toddler waits on the left, one may run after him.",
    "A van is ahead; it could get tight.",
    "The lorry on the left leaves room, but there's a risk of touching its mirror.",
    "I wouldn't call the bus ahead an active conflict, but a potential one.",
    "| car | front | same direction | potential | decelerate | straight |",
]
NO_CONFLICT = [
    "The bus on the left doesn't really affect us.",
    "The pedestrian on the right isn't a threat to us.",
    "A cyclist is on the right; I don't see any risk.",
    "The car behind poses no danger.",
    "A lorry is oncoming. Risk: none",
    "A lorry is oncoming; the risk is nil.",
    "The lorry on the right: no conflict.",
    "He waits at the kerb. The jogger does not affect the ego vehicle.",
    "The truck on the left does not interfere with our motion.",
]
RESOLVED = [
    "The conflict with the van is now fully resolved.",
    "The danger is over.",
    "The critical situation has passed.",
    "The cyclist ahead is no longer any risk.",
    "The scooter is no risk any more.",
    "The taxi that cut in a moment ago is no longer a risk.",
    "The pedestrian has left the road.",
    "There is no further risk from the truck ahead.",
    "The cyclist ahead is not in conflict with us anymore.",
    "The cut-in by the van is complete. No danger remains.",
    "The cyclist has passed, the path is clear again.",
    "The tractor has cleared our lane.",
    "The potential conflict with the jogger has dissolved.",
]
NONE = [
    "A cyclist is crossing ahead, so yield.",
    "A truck ahead has its hazard lights on.",
    "The car on the right has crossed the lane line.",
    "In general cyclists may swerve.",
    "Ice can't be excluded.",
    "A tram doesn't concern us.",
    "The car may slow down or keep its speed.",
    "We could slow down.",
    "The van ahead may have stopped.",
    "Was the danger over?",
]


def test_the_rules_read_conflicts() -> None:
    labelled = {"active": ACTIVE, "potential": POTENTIAL, "no_conflict": NO_CONFLICT,
                "resolved": RESOLVED}  # fmt: skip
    cases = [(text, f"c={label}") for label, table in labelled.items() for text in table]
    assert holds(score([*cases, *((text, "") for text in NONE)], ("conflict",)), 0.95, 0.65)
