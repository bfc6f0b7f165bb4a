"""Stage 5: when a noun or a pronoun means the VUT."""

from __future__ import annotations

from ssp_eval.extract.rules.hits import Hit, Kind
from ssp_eval.extract.rules.talk import EGO, SCENE, Talk
from ssp_eval.extract.rules.words.ego_verbs import LAT_ACTIONS, LON_ACTIONS

_PERCEIVE = frozenset(
    {"see", "notice", "observe", "spot", "detect", "perceive", "recognise", "recognize", "find"}
    | {"make", "count", "note", "identify", "can", "have"}
)
_EITHER = frozenset({"turn", "change_left", "change_right", "keep_lane", "keep_speed", "change"})


def read_ego(talk: Talk, index: int, hit: Hit) -> None:
    if talk.words[hit.first - 1 : hit.first + 2 : 2] == ["(", ")"]:
        return  # (i)
    if index > talk.start and talk.hits[index - 1].kind is Kind.REACT:
        return
    if (
        talk.busy
        and talk.subject is not None
        and hit.stop - hit.first == 1
        and (talk.words[hit.first] in ("us", "me"))
    ):
        return
    if hit.stop < len(talk.words) and talk.words[hit.stop] in _PERCEIVE and talk.pending:
        return  # in front I notice a van
    if talk.words[hit.first] not in ("us", "me"):
        talk.subject = EGO
        talk.ego_named = talk.ego_named or talk.words[hit.first] not in ("i", "we", "you")
        talk.busy = False
        talk.near = None
        talk.pending = []


def ego_role(talk: Talk, index: int, hit: Hit) -> str:
    """What an unmodified "the car" is that nobody introduced: some texts call the VUT so.

    With "should" it is the VUT; with a turn or a lane keeping it may be either and counts for none.
    """
    known = any(actor.name == hit.value for actor in talk.world.actors)
    bare = hit.first > 0 and talk.words[hit.first - 1] == "the"
    if bare and hit.value == "car" and _ought(talk, index):
        return EGO
    if known or not bare or hit.value != "car" or index + 1 >= talk.stop:
        return ""
    following = talk.hits[index + 1]
    if following.kind is Kind.MODAL and following.value == "must":
        return EGO
    if following.kind is Kind.MODAL and following.value == "may" and acts(talk, index):
        return SCENE  # the car may slow down or keep its speed: the VUT or another
    before = talk.hits[index - 1] if index > talk.start else None
    if (
        before is not None
        and before.kind is Kind.VERB
        and before.stop == hit.first - 1
        and (before.value in LON_ACTIONS or talk.planner.steers(before))
    ):
        return EGO  # stop the car
    if following.kind is Kind.AUX and index + 2 < talk.stop:
        following = talk.hits[index + 2]
    if following.kind is Kind.VERB and following.value in _EITHER:
        talk.ego_is_car = True
    if talk.ego_is_car and following.kind not in (Kind.PLACE, Kind.SIDE):
        return SCENE
    return ""


def _ought(talk: Talk, index: int) -> bool:
    """The car should slow down, and the car that an action field speaks of: both are the VUT."""
    if index + 1 >= talk.stop:
        return False
    following = talk.hits[index + 1]
    known = any(actor.name == "car" for actor in talk.world.actors)
    opens = index > talk.start and talk.hits[index - 1].value in (":", "[")
    if talk.key == "action" and (opens or not known):
        return following.kind not in (Kind.PLACE, Kind.SIDE, Kind.STATE)
    ordered = following.value == "must" or talk.words[following.first] == "shall"
    return following.kind is Kind.MODAL and ordered and acts(talk, index)


def after_ego(talk: Talk, index: int) -> bool:
    if index == talk.start or (index == talk.start + 1 and talk.hits[index - 1].kind is Kind.THEN):
        return talk.after_ego()
    planned = talk.planner.first is not None and talk.ego_named
    return planned and talk.hits[index - 1].value in (";", ":")


def acts(talk: Talk, index: int) -> bool:
    """Whether one of the ego's actions follows: it stays in its lane, it should slow down."""
    for after in range(index + 1, min(index + 4, talk.stop)):
        hit = talk.hits[after]
        if hit.kind is Kind.VERB:
            return hit.value in LON_ACTIONS or hit.value in LAT_ACTIONS
        if hit.kind not in (Kind.MODAL, Kind.AUX, Kind.THEN, Kind.READY):
            return False
    return False
