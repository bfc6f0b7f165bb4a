"""Phrases for fixed places around the ego, as data: ahead, at the front left."""

from __future__ import annotations

from ssp_eval.extract.rules.words.notation import Table, phrases

_CORNER_PREPS = ("", "in ", "at ", "on ", "to ", "in the ", "at the ", "on the ", "to the ", "our ",
                 "to our ", "on our ", "at our ")  # fmt: skip
_CORNERS = {"front": ("front", "ahead", "forward", "upper"), "rear": ("rear", "behind", "back")}


def _corner(end: str, side: str) -> tuple[str, ...]:
    pairs = ((side, one) if swapped else (one, side) for one in _CORNERS[end]
             for swapped in (False, True))  # fmt: skip
    return tuple(" ".join(pair) for pair in pairs if pair not in {(side, "behind"), (side, "back")})


# Fixed positions; "of X" behind them is looked at by matching/sides.py.
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
