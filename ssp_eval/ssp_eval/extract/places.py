"""Stage 5: where somebody is."""

from __future__ import annotations

from ssp_eval.extract.hits import Hit, Kind
from ssp_eval.extract.talk import EGO, SCENE, Talk
from ssp_eval.extract.world import Actor


def read_place(talk: Talk, index: int, hit: Hit) -> None:
    if talk.subject is SCENE and talk.near is None:
        return
    actor = talk.near or (talk.subject if isinstance(talk.subject, Actor) else None)
    if talk.key == "position":
        talk.put(talk.world.loose, index, talk.flags[index])
    elif actor is None:
        if talk.subject is not EGO:
            talk.pending.append(index)
    elif talk.adjoins(index):
        noun = talk.named[-1][0] if talk.named else index
        talk.put(actor, index, talk.flags[index] & talk.flags[noun])
    else:
        together = talk.group if actor in talk.group else [actor]
        for one in together:
            talk.put(one, index, talk.flags[index])


def read_side(talk: Talk, index: int, hit: Hit) -> None:
    if hit.form in ("from", "into"):
        return
    if talk.planner.takes_side(index):
        return
    if hit.form == "lane":
        following = talk.hits[index + 1] if index + 1 < talk.stop else None
        if following is not None and following.kind is Kind.OBJECT:
            talk.pending.append(index)
        elif talk.key == "position":
            read_place(talk, index, hit)
        return
    if hit.form == "bare" and talk.key != "position" and not _beside_place(talk, index):
        return
    if hit.form == "to" and _moving_to(talk, index):
        return
    read_place(talk, index, hit)


def _beside_place(talk: Talk, index: int) -> bool:
    near = talk.hits[max(index - 1, talk.start) : index + 2]
    return any(hit.kind is Kind.PLACE for hit in near)


def _moving_to(talk: Talk, index: int) -> bool:
    previous = talk.hits[index - 1] if index > talk.start else None
    return previous is not None and (
        previous.kind is Kind.VERB or (previous.kind is Kind.SIDE and previous.form == "from")
    )
