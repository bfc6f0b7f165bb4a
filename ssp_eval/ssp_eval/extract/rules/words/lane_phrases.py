"""Phrases for being in the ego's lane or path, as data."""

from __future__ import annotations

from ssp_eval.extract.rules.words.notation import phrases

# Whose lane it is that somebody stays or brakes in.
OWN_LANE = phrases(
    """
    our, my, its, the ego, the current, our own, my own, its own, the own, the same, the, own,
    this, the present, the ego vehicle, our current, its current, your, your own, ego
    """
)
IN_PATH = phrases(
    """
    in the path of the ego, in the path of the ego car, in the path of the ego vehicle, in the
    path of our car, in the path of our vehicle, in the ego vehicle path, in our
    driving path, in our driving corridor, inside our driving corridor, in our corridor, in my way
    """
)
SAME_LANE = phrases("in lane, same lane, without leaving the lane, without leaving our lane")
