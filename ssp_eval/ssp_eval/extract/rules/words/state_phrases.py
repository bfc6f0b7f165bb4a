"""Phrases for what somebody is doing that are no verb, as data: at rest, oncoming."""

from __future__ import annotations

from ssp_eval.extract.rules.words.notation import Table, phrases

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
