"""The owner of places, movements, conflicts and actions: the VUT or a road user.

docs/binding.md explains the state of the reading, which ``ClauseFacts`` owns, and reads sentences
step by step.
"""

from __future__ import annotations

from collections.abc import Iterator

from ssp_eval.extract.clause import EGO, PEOPLE, RIDERS, SCENE, ClauseFacts
from ssp_eval.extract.match import Hit
from ssp_eval.extract.movement import (
    ALONG,
    BLOCKING,
    CROSSING,
    CUTTING_IN,
    OTHER_SIDE,
    is_behind,
    is_over_by_then,
    motion_of,
    passed_side,
    rear_side,
)
from ssp_eval.extract.scope import Scope
from ssp_eval.extract.world import Actor, Statement, World

_ENDANGERS = frozenset({"cross", "intrude", "drift", "step", "leave"})
_UNSAFE = frozenset({"open", "accelerate", "hide"})
_AUXILIARIES = frozenset({"may", "will", "not", "ready", "must", "is", "past", "intend"})
_OURS = frozenset({"our", "my", "ego", "own", "us", "same"})
_MAYBE = Scope.POSSIBLE | Scope.FUTURE | Scope.LATER | Scope.IMAGINED | Scope.INTENDED
_REAR = frozenset({"behind", "rear", "bumper", "tail", "heels"})
_BEGINS = ("start", "begin", "began", "continu", "commenc")
_US = frozenset({"us", "me"})
_PACES = frozenset({"speed", "pace", "tempo"})
_OTHER_SEX = {"he": "she", "she": "he"}
# What may say of somebody absent that only an act, or one at a place, is meant.
_LIMITS = frozenset({"verb", "relative", "cue", "place", "braked_in_lane", "from", "state"})
_FRAMES = frozenset({"frame", "frames", "image", "picture", "t"})
_ORDINALS = frozenset({"first", "second", "third", "last", "latest", "newest", "final"})


def _frames(words: list[str]) -> Iterator[str]:
    """Yield the frames that a text mentions: frame 2, the last image, t-1."""
    for before, word, after in zip(["", *words], words, [*words[1:], ""], strict=False):
        if word in _FRAMES and (after[:1].isdigit() or before in _ORDINALS):
            yield after if after[:1].isdigit() else before


class Binder(ClauseFacts):
    """One pass over the hits of a text, sentence by sentence."""

    def run(self, ranges: list[tuple[int, int]]) -> World:
        """Read all sentences."""
        self.world.frames = len(set(_frames(self.words))) > 1
        self.world.sentences = len(ranges)
        ordered = False  # the sentence before is an order of one word
        for number, (start, stop) in enumerate(ranges):
            self.unit = number
            bare = self._is_bare_order(start, stop)
            self.step += not (bare and ordered)
            ordered = bare
            self._begin(start, stop)
            for index in range(start, stop):
                self._at = index
                self._read(index, self.hits[index], self.flags[index])
            self._close()
        return self.world

    def _read(self, index: int, hit: Hit, flags: Scope) -> None:  # noqa: C901  # a table of cases, one a line
        kind = hit.kind
        if kind == "mark":
            self._mark(index, hit)
        elif kind == "cue":
            self._cue(hit)
        elif kind == "user":
            self._user(index, hit, flags)
        elif kind == "ego":
            following = self._after(index)
            acts = following.kind == "verb" and following.form == "s"
            opens = acts and following.first == hit.stop  # to stay clear the VUT steers
            if opens or (not self.busy and (self.near is None or not self._attributed(index))):
                self.subject, self.near = EGO, None
        elif kind == "pronoun":
            self._pronoun(index, hit)
        elif kind == "relative":
            self.void = self.near is None or self.words[hit.first] == "whose"
            if self.near is not None:
                self.subject, self.busy = self.near, False
        elif kind == "scene":
            if (self.near is not None or self.planned or isinstance(self.subject, Actor)) and (
                self.known.sets["prepositions_of_place"]
                & set(self.words[max(hit.first - 3, 0) : hit.first])
            ):
                return  # on the sidewalk
            if not self.busy and not isinstance(self.subject, Actor):
                self.subject = SCENE
            self.pending, self.near, self.void = [], None, True
        elif kind in ("place", "towards") and not self._directed(index):
            self._place(index, hit, flags)
        elif kind in ("from", "across", "towards", "goal"):
            self._path(index, hit)
        elif kind == "verb":
            self._verb(index, hit, flags)
        elif kind in ("noun", "action"):
            self._noun(index, hit, flags)
        elif kind == "state":
            self._state(index, hit, flags)
        elif kind == "braked_in_lane":
            if index == self.start and self._after(index).value in (".", "\n") and self.plan.made():
                self.plan.act(hit._replace(kind="action", value="straight"), flags, self.step)
                return  # Brake. In lane.
            actor = self._owner()
            sides = {"left", "right"} & set(self.words[hit.first : hit.stop])
            is_near = self.near is not None and self._adjoins(index)
            if (
                sides
                and actor is not None
                and (is_near or (not self.planned and self.subject is not EGO))
            ):
                self._place(index, hit._replace(kind="place", value=sides.pop()), flags)
                return  # a van in the right lane
            if sides and actor is None and self.subject is None and not self.planned:
                self.pending.append((index, hit._replace(kind="place", value=sides.pop())))
                return  # in the right lane, a van
            if actor is not None:
                ours = not _OURS.isdisjoint(self.words[hit.first : hit.stop])
                actor.matters = actor.matters or ours
                if ours and not self.planned and not flags:
                    actor.hints.append(self._said("front", hit))
            if self.planned and self.near is None:
                self.plan.in_lane(hit, self.step)
        elif kind in ("conflict", "risk", "affects"):
            self._conflict(index, hit, flags)
        elif kind == "field":
            self._field(hit)
        elif kind == "matters" and self._is_from_rear(hit):
            self._place(index, hit._replace(kind="place", value="rear"), flags)
        else:
            self._salience(index, hit, flags)

    # --- structure of the sentence

    def _mark(self, index: int, hit: Hit) -> None:
        if hit.value == "," and index + 1 < self.stop and self.hits[index + 1].kind == "place":
            return
        self.busy = self.void = False
        self.clause = index + 1
        if self._orders_behind_reason(index):
            self.subject = self.near = None  # because two boys may step out, brake
        if self.pending and hit.value == "," and self._holds_more(index):
            self.pending = []  # roadworks ahead, flagman waving
        if hit.value in (";", ":", "|", "{", ">") and (
            self.field not in ("motion", "position", "conflict")
        ):
            self.subject = None
        if hit.value in ("{", "|") and not self.field:
            self.near = None

    def _cue(self, hit: Hit) -> None:
        around = self.words[hit.first - 1 : hit.first], self.words[hit.stop : hit.stop + 1]
        if hit.value == "but" and around == ([","], [","]):
            return
        after = self._after(self._at)
        if self.words[hit.first] == "therefore" and self.subject is EGO and after.form == "s":
            return  # the VUT therefore brakes
        if hit.value == "while" and after.form == "ing":
            return  # braking while turning
        if hit.value == "but" and self.planned:
            self.step += 1
        if hit.value == "ready" and self.words[hit.first].startswith("wait"):
            self._wait(hit)
        if hit.value == "reject" and self.words[hit.first].startswith("avoid"):
            self.reacting = True
        if hit.value in ("but", "so", "because", "while", "if", "then", "final", "before"):
            self.busy = self.void = False
            self.because = self.because or hit.value == "because"
            if hit.value in ("because", "so", "while", "if", "but", "before"):
                self.subject = None
                self.near = None if hit.value != "before" else self.near
            if hit.value == "final":
                self.plan.final = True
                self.plan.sequence = None
        elif hit.value == "revise":
            self.step += 1
            self.world.revised.append(self.step)
        elif hit.value == "meta" or (hit.value == "step" and self._is_order(self._at)):
            self.plan.sequence = (hit.value == "step" and self.plan.sequence) or set()
            self.busy = False
        elif hit.value == "and":
            self.busy = False

    def _wait(self, hit: Hit) -> None:
        """Note that somebody stands who is waiting to do something: waiting to turn left."""
        owner = self._owner()
        if owner is not None and self.subject is not EGO and not self.flags[self._at]:
            owner.motions.append(self._said("stationary", hit))
            self._show(owner)

    def _field(self, hit: Hit) -> None:
        self.field = hit.value
        self.busy = False
        if hit.value in ("lon_action", "lat_action", "action", "conflict") or (
            not hit.value and self.words[hit.first - 1].isalpha() and hit.first - 4 < self._line()
        ):
            self.listing = False
        if hit.value in ("lon_action", "lat_action", "action"):
            self.subject, self.near = None, None
        elif hit.value == "objects":
            self.subject, self.near = None, None
            self.listing = True

    def _close(self) -> None:
        if self.planned:
            for actor in self.named:
                actor.reaction = max(actor.reaction, 1)

    # --- road users

    def _user(self, index: int, hit: Hit, flags: Scope) -> None:
        if self._is_ego(index, hit, self._known(hit)):
            # What the VUT is doing is no plan.
            self.subject, self.near = SCENE if self._after(index).value == "is" else EGO, None
            return
        following = self._after(index)
        if hit.form != "the" and following.value == "may" and following.first == hit.stop:
            flags |= Scope.POSSIBLE  # a child may run out: there is none
        if flags & (Scope.QUOTED | Scope.DENIED | Scope.IMAGINED | Scope.POSSIBLE | Scope.PAST):
            user, alone = self._known(hit), not self.words[hit.first - 1].isalpha()
            is_real = hit.form == "the" or flags == Scope.PAST or alone
            if user is None and is_real and not flags & (Scope.QUOTED | Scope.DENIED):
                user = self._identify(hit)
                user.first = self._said(user.name, hit)
            if user is None and flags == Scope.DENIED and following.kind not in _LIMITS:
                self._deny(hit)
            if user is None or flags & Scope.QUOTED:
                self.subject, self.near, self.void = SCENE, None, True
                self.pending, self.states = [], []
                return
            actor = user
        else:
            actor = self._is_a(index, hit) or self._identify(hit)
            actor.mentions.append(self._said(actor.name, hit))
        self.named.append(actor)
        self.void = False
        adjoining = self._before(index).kind == "user"
        self.near = self.last = actor
        if self._opens_clause(index):
            self.subject, self.busy = actor, False
        elif not self.busy and self.subject is not EGO and not adjoining:
            self.subject = actor
        because = self.planned and self.because and self.named[:-1] == []
        if self.reacting or because or self._reacted_to(index):
            actor.reaction = 2
        if self.critical or (
            self.listing and (self.subject is actor or len(self.named) == 1) and not self.shows
        ):
            actor.critical = True
        if self.shows:
            actor.matters = True
        if len(actor.mentions) == 1 and self._is_dismissed():
            actor.background = True
        if self.behind is not None and hit.first - self.behind.stop < 6:
            actor.hints.append(self._said("front", self.behind))
        self.behind = None
        for at, place in self.pending:
            self._put(actor, place, self.flags[at])
        for state in self.states:
            self._rest(actor, state)
        self.pending, self.states, self.reacting = [], [], False

    def _deny(self, hit: Hit) -> None:
        """Note a kind of road users that is absent.

        Where several kinds are, cars among them, no road user is there.
        """
        self.denied.add(hit.value)
        if "car" in self.denied and len(self.denied) > 1:
            self.world.nobody.append(self._said("", hit))

    def _pronoun(self, index: int, hit: Hit) -> None:
        last = self.last
        if (
            hit.value == "it"
            and index - self.clause < 3
            and not self.busy
            and (
                (self.subject is EGO and not self.named)
                or (self.carried is EGO and not self.were_named)
            )
        ):
            self.subject, self.near = EGO, None
            return
        if hit.value == "it" and last is not None and last.name in PEOPLE:
            last = next((a for a in reversed(self.world.actors) if a.name not in PEOPLE), None)
        if hit.value in _OTHER_SEX:
            other = self.known.sets[_OTHER_SEX[hit.value]]
            if last is None or last.name not in RIDERS or last.noun in other:
                fitting = (a for a in reversed(self.world.actors) if a.name in RIDERS)
                last = next((a for a in fitting if a.noun not in other), None)
        if hit.value in ("they", "both") and (last is None or not last.plural):
            last = next((a for a in reversed(self.world.actors) if a.plural), None)
        if not self.busy or self.subject is None:
            self.subject = last if last is not None else SCENE
        self.void = last is None
        if last is not None:
            self.near = last
            if self._reacted_to(index):
                last.reaction = 2

    # --- places and movements

    def _path(self, index: int, hit: Hit) -> None:
        """Remember a path for the words that follow: in our path, from the right."""
        owner = self._owner()
        if owner is None and index == self.start and self.words[hit.first] == "in":
            owner = self.last  # in our path, must brake
        back = self._back(index, 4)
        before = next((one for one in back if one.kind != "place" and one.value != ","), hit)
        bare = before.kind == "user" and hit.first - before.stop < 6 and not self.flags[index]
        lane = "lane" in self.words[hit.first : hit.stop]
        if hit.kind in ("from", "across") and bare and owner is not None and not lane:
            owner.origin = self._said(hit.value, hit)
        if hit.kind == "goal" and self.words[hit.first] in ("in", "inside") and owner is not None:
            self.in_path = self.was_in_path = (owner, hit)
            if not self.flags[index] and not _OURS.isdisjoint(self.words[hit.first : hit.stop]):
                owner.hints.append(self._said("front", hit))
                if self.because and self._had_to():
                    owner.conflicts.append(self._said("active", hit))

    def _place(self, index: int, hit: Hit, flags: Scope) -> None:
        owner = self._owner()
        after = self.words[hit.stop] if hit.stop < len(self.words) else "."
        if after == "of" and (self._other(index) or self._is_before_thing(hit)):
            return
        if self.words[hit.first] in OTHER_SIDE and self.words[hit.first - 1] in ("the", "a"):
            return  # blocks the left lane
        opens = self.words[hit.stop - 1] not in _US  # behind the van, but: behind us a van
        behind = after in self.known.sets["articles_and_pronouns"] or (
            self.words[hit.stop - 1] == "behind" and self._names_thing(index)
        )
        if hit.value == "rear" and opens and (behind or self._after(index).kind == "user"):
            if self._queues(index, flags):
                self.behind = hit
            self.reacting = self.reacting or bool(self.planned) or self.subject is EGO
            return  # behind the van
        if hit.form == "lead":
            self.pending.append((index, hit))
            return
        if self._leads(index):
            return
        side = hit.value.rpartition("_")[2]
        if not flags and side in OTHER_SIDE and self._is_passed(index):
            self.plan.act(Hit("action", side, "", hit.stop - 3, hit.stop), flags, self.step)
            if owner is not None and hit.value.startswith("front"):
                self._put(owner, hit._replace(value="front"), flags)
            return
        if (
            self.words[hit.first] == "straight"
            and hit.stop - hit.first == 2
            and (self.planned and (owner is None or self.subject is EGO))
        ):
            straight = Hit("action", "straight", "", hit.first, hit.stop)
            self.plan.act(straight, flags, self.step, self._strong())
            return
        if self.void or (self.subject is SCENE and self.near is None):
            return
        if owner is None or (self.subject is EGO and self.near is None):
            self.pending.append((index, hit))
        else:
            self._put(owner, hit, flags)

    def _put(self, actor: Actor, hit: Hit, flags: Scope) -> None:
        if not flags & ~(Scope.REJECTED | Scope.PLANNED | Scope.FUTURE | Scope.LATER):
            actor.places.append(self._said(hit.value, hit))
            self._show(actor)

    def _show(self, actor: Actor) -> None:
        """Mark a road user that was only named before as present."""
        if not actor.mentions and actor.first is not None:
            actor.mentions.append(actor.first)

    def _state(self, index: int, hit: Hit, flags: Scope) -> None:
        following = self._after(index)
        if following.kind == "user" and following.first - hit.stop < 3:
            self.states.append(hit)
            return
        owner = self._owner()
        if owner is None and not _PACES.isdisjoint(self.words[hit.first : hit.stop]):
            self._noun(index, hit._replace(kind="noun", value="maintain"), flags)
            return  # same speed, of the VUT
        if owner is None or self.void or (self.subject is EGO and self.near is None):
            return
        if not flags & ~(Scope.REJECTED | Scope.FUTURE | Scope.LATER):
            self._rest(owner, hit)

    def _rest(self, actor: Actor, hit: Hit) -> None:
        value = hit.value
        if value == "parked":
            actor.parked, value = True, "stationary"
        if self.words[hit.first] == "faster" and any(
            place.value.startswith("rear") for place in actor.places
        ):
            value = "same_direction"  # from behind us it comes nearer
        actor.motions.append(self._said(value, hit))
        self._show(actor)

    def _verb(self, index: int, hit: Hit, flags: Scope) -> None:
        meaning = self.known.verbs[hit.value]
        if self._adjective(index, hit, meaning.other):
            return
        if self.field == "forecast" and not flags & Scope.POSSIBLE:
            return
        if flags == Scope.POSSIBLE and self.subject in (None, SCENE) and self.near is None:
            if self.subject is None and self.last is not None and (self._may(index)):
                self._move(self.last, index, hit, flags)
                return
            if meaning.other in ("step", "cross", "drift", "intrude") and (
                self._nobody_known(index) and self._may(index)
            ):
                self.world.loose.append(self._said("potential", hit))
                return
        resumed = self.last if self._resumes(index, hit) else None
        if resumed is not None or self._of_other(index, hit):
            owner = resumed or self._mover(index, hit)
            if owner is not None:
                self._move(owner, index, hit, flags)
            self.busy = self.busy or hit.form != "ing" or isinstance(self.subject, Actor)
            return
        if self._hindered(index, hit) or (
            hit.form == "base"
            and hit.first
            and self.words[hit.first - 1] == "to"
            and index > self.start
            and self.hits[index - 1].kind in ("user", "pronoun")
            and self.hits[index - 1].stop == hit.first - 1
        ):
            self.busy = True  # wait for the car to stop; our merge that somebody blocks
            return
        if (hit.form == "ing" and self._gerund(index, hit)) or self._is_of_named(hit):
            self.busy = True
            return
        if self.plan.act(hit, flags, self.step, self._strong()):
            self.planned.append(hit)
            if self.in_path is not None and self._before(index).value == "must":
                actor, place = self.in_path
                actor.conflicts.append(self._said("active", place))
            if self.subject is None:
                self.subject = EGO
        elif not meaning.ego:
            self.reacting = self.reacting or self._goes_by(index, hit, flags)
        if (
            hit.value == "trail"
            and self.subject in (None, EGO)
            and hit.form != "ed"
            and (not flags & ~(Scope.FUTURE | Scope.REJECTED))
        ):
            self.behind = hit
        self.busy = True

    def _adjective(self, index: int, hit: Hit, other: str) -> bool:
        """Tell whether a verb is its noun's attribute: the stopped taxi, an overtaking bus."""
        following = self.hits[index + 1 : index + 3]
        if following and following[0].form == "lead":
            following = following[1:]
        if not following or following[0].kind != "user" or following[0].first - hit.stop > 2:
            return False
        article = self.words[hit.first - 1] in ("the", "a", "an", "slow", "slower")
        kinds = {
            "stand": "stationary",
            "with": "same_direction",
            "along": ALONG,
            "go": ALONG,
            "oncoming": "oncoming",
        }
        if other not in kinds or not (hit.form == "ed" or article):
            return False
        self.states.append(Hit("state", kinds[other], "", hit.first, hit.stop))
        return True

    def _mover(self, index: int, hit: Hit) -> Actor | None:
        if isinstance(self.subject, Actor) and (hit.form != "ing" or not self._adjoins(index)):
            return self.subject
        return self._owner()

    def _of_other(self, index: int, hit: Hit) -> bool:
        """Tell whether a verb is somebody else's, not the VUT's."""
        if self.field in ("motion", "position"):
            return True
        if self._adjoins(index) and hit.form in ("ing", "s", "ed"):
            return True
        if isinstance(self.subject, Actor):
            before = self._before(index)
            auxiliary = before.kind == "cue" and before.value in _AUXILIARIES
            begins = self.words[hit.first - 2].startswith(_BEGINS)
            finite = auxiliary or begins or before.kind in ("user", "pronoun", "relative")
            return hit.form != "base" or self.subject.plural or finite
        if self.subject is SCENE:
            return True
        return self.subject is None and hit.form in ("s", "ed") and self.field != "action"

    def _move(self, actor: Actor, index: int, hit: Hit, flags: Scope) -> None:
        meaning = self.known.verbs[hit.value]
        kind = meaning.other
        goals = self._goals(index)
        if flags & Scope.POSSIBLE and not flags & ~_MAYBE:
            into = {goal.value for goal in goals} & {"into_ours", "across"}
            if (kind in _ENDANGERS or into or hit.value in _UNSAFE) and self._may(index):
                actor.conflicts.append(self._with_cue("potential", index, ("may",)))
            return
        over = is_over_by_then(hit, kind, self._before(index), self.words)
        if flags & ~(Scope.REJECTED | Scope.LATER) or over:
            return
        value = motion_of(actor, kind, goals, hit, self.words)
        if hit.value == "trail" and not flags and is_behind(actor, []):
            value = "same_direction"
        if side := passed_side(hit, self.words):
            if not self._goes_on(index):
                return  # slow truck ahead, overtaking on the left
            actor.hints[:] = actor.hints or [self._said(side, hit)]
        if value is None:
            return
        stop = max([hit.stop, *(goal.stop for goal in goals)]) if "_from_" in value else hit.stop
        actor.motions.append(Statement(value, hit.first, stop, self.unit))
        self._show(actor)
        if self.words[hit.first].startswith(("lead", "preced")):
            actor.hints.append(self._said("front", hit))
        elif kind == "with" and not _REAR.isdisjoint(self.words[hit.first : hit.stop]):
            actor.hints.append(self._said(rear_side(hit, self.words), hit))
        actor.intruding = actor.intruding or value.startswith((CROSSING, CUTTING_IN))
        before = self.words[max(hit.first - 2, 0) : hit.first]
        actor.ongoing = hit.form == "ing" and not {"is", "are"}.isdisjoint(before)

    # --- actions, conflicts, salience

    def _noun(self, index: int, hit: Hit, flags: Scope) -> None:
        theirs = isinstance(self.subject, Actor) and not self.planned and not self._strong()
        steady = theirs and hit.value == "maintain" and not flags and self._adjoins(index)
        if steady and isinstance(self.subject, Actor):  # lorry, steady 80
            self.subject.motions.append(self._said("same_direction", hit))
        if (theirs and hit.kind == "noun") or self._hindered(index, hit):
            return
        others = ("motion", "position", "objects", "forecast")
        if self.field in others or (hit.kind == "action" and self.field == "conflict"):
            return
        after = self._after(index)
        if (
            hit.value == "straight"
            and after.first == hit.stop
            and (after.kind in ("place", "towards"))
        ):
            return  # no steering to the left
        if self.plan.act(hit, flags, self.step, self._strong() or hit.form == "value"):
            self.planned.append(hit)

    def _conflict(self, index: int, hit: Hit, flags: Scope) -> None:  # noqa: C901  # a table of cases, one a line
        if flags & (Scope.QUOTED | Scope.PAST | Scope.REJECTED | Scope.PLANNED):
            return
        value = hit.value
        if value == "forced":
            if self.in_path is not None and not flags & ~(Scope.FUTURE | Scope.DENIED):
                actor, place = self.in_path
                actor.conflicts.append(self._said("active", place))
            return
        denied = bool(flags & Scope.DENIED)
        if hit.kind == "conflict":
            if denied and value == "active" and "without" in self._sentence():
                denied = False
            if denied:
                value = "no_conflict" if value == "potential" else ""
            elif value == "no_conflict" and self._no_longer(hit):
                value = "resolved"
            elif flags & Scope.POSSIBLE and value == "active":
                would = {"would", "i'd"} & set(self._sentence())
                value = "" if would else "potential"
            if flags & Scope.IMAGINED and (value != "active" or not self._unless()):
                value = ""
            if value == "resolved" and (
                flags & (Scope.POSSIBLE | Scope.FUTURE) or self._later(hit)
            ):
                return
        elif denied:
            near = self.hits[index + 1 : index + 3]
            if any(one.kind == "conflict" for one in near):
                return
            value = "resolved" if self._no_longer(hit) else "no_conflict"
        elif hit.kind == "risk":
            risky = self.words[hit.first] in ("risk", "danger", "hazard", "threat")
            asserted = self.words[hit.first - 1] in ("a", "is", "some", "the")
            is_present = (risky and asserted) or self._is_rated(index)
            value = "potential" if flags & Scope.POSSIBLE or is_present else ""
            if {"none", "nil", "no"} & set(self.words[hit.stop : hit.stop + 2]):
                value = "no_conflict"
            if flags & Scope.IMAGINED:
                value = ""
        else:
            value = "potential" if flags & Scope.POSSIBLE else ""
        if hit.kind in ("conflict", "risk") and not denied and self._has_ended(index):
            value = "resolved"
        if not value:
            return
        if self.subject is SCENE and self.near is None and hit.kind == "affects":
            return
        statement = self._with_cue(value, index, ("no", "not", "may"))
        owner = self.subject if isinstance(self.subject, Actor) else self.near
        following = self._after(index)
        if following.kind == "user" and following.first - hit.stop < 5:
            owner = self._identify(following)
        if owner is None:
            self.world.loose.append(statement)
        else:
            owner.conflicts.append(statement)

    def _salience(self, index: int, hit: Hit, flags: Scope) -> None:
        owner = self._owner()
        if hit.kind == "nobody":
            if self._after(index).value == "is":  # nobody is waiting at the crosswalk
                self.subject = SCENE
            after = self.hits[index + 1 : index + 3]
            acts = any(one.kind in ("verb", "relative") for one in after)
            if not flags & ~Scope.DENIED and not (acts and hit.stop - hit.first < 3):
                self.world.nobody.append(self._said("", hit))
        elif hit.kind == "reacts":
            self.reacting = self.reacting or self.subject in (EGO, None)
        elif flags & (Scope.QUOTED | Scope.IMAGINED):
            return
        elif hit.kind == "critical":
            if flags & Scope.DENIED:
                if owner is not None:
                    owner.background = True
            elif self.near is not None:
                self.near.critical = True
            else:
                self.critical = True
        elif hit.kind == "background" and not self._is_of_conflict(index):
            whom = self.subject if isinstance(self.subject, Actor) else owner
            for actor in [whom] if whom else self.named[-1:]:
                actor.background = True
        elif hit.kind == "matters":
            if owner is not None:
                owner.matters = True
                if not flags and self._blocks(hit):
                    owner.motions.append(self._said(BLOCKING, hit))
                    self.in_path = self.was_in_path = (owner, hit)
                if flags == Scope.POSSIBLE and self.words[hit.first].startswith(("hid", "conceal")):
                    owner.conflicts.append(self._said("potential", hit))
            self.shows = True
