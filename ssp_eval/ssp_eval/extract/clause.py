"""The state of the reading within a sentence, and what is asked of the hits around one."""

from __future__ import annotations

from itertools import pairwise

from ssp_eval.extract.lexicon import lexicon
from ssp_eval.extract.match import MARKS, NOTHING, Hit
from ssp_eval.extract.scope import Scope
from ssp_eval.extract.speaker import has_us
from ssp_eval.extract.world import Actor, Plan, Statement, World

EGO = "ego"
SCENE = "scene"
REACH = 24  # hits that a look along the sentence covers, so that the whole stays linear
_SPEED_ACTIONS = frozenset({"stop", "decelerate", "maintain", "straight", "both"})
_STANDS = frozenset({"wait", "trail"})
_PRESENT = frozenset({"is", "has", "have", "are"})
ENDS_WITHIN = 6  # hits behind a conflict in which it is said to be over
_PASSED = frozenset({"passed", "past", "crossed", "gone", "cleared"})
_DESCRIBING = frozenset(
    {"place", "state", "cue", "towards", "user", "ego", "scene", "braked_in_lane"}
)
_OWN = frozenset({"our", "my", "us", "me", "ego", "the", "your", "bonnet", "bumper", "nose"})
_OWNERS = frozenset({"our", "my"})
_INTO = frozenset({"into", "onto"})
_BARE = 2  # words of an order that is a sentence
_PLACES = 3  # of a road user, before its verb
_ENDS_PLACES = MARKS | {"and", "so", "on", "at", "in", "while", "but", "is", "as", "because"}
_GOALS = frozenset({"goal", "from", "across", "towards", "place"})
PASSES = ("overtak", "pass")  # beginnings of what somebody is the object of
PEOPLE = frozenset({"pedestrian"})
RIDERS = frozenset({"pedestrian", "cyclist", "motorcycle"})
_GENERIC = frozenset({"vehicle", "car", "vehicles", "cars"})
_CALLED = frozenset({("bike", "motorcycle"), ("cab", "truck"), ("bike", "cyclist")})
_LEADING_ON = frozenset({"go", "drift", "step", "cross", "leave"})
_UNSEEN = frozenset(
    {
        "someone",
        "somebody",
        "one",
        "anyone",
        "child",
        "car",
        "pedestrian",
        "person",
        "he",
        "it",
        "children",
        "people",
        "kids",
        "pedestrians",
        "passengers",
        "passenger",
        "driver",
        "rider",
        "animal",
        "others",
    }
)
_NAMED_IN_CONFLICT = frozenset({"user", "pronoun", "place", "ego", "state", "risk", "conflict"})
_ANY_MORE = ("no longer", "any more", "anymore", "any longer", "no more", "no further")


def _same_noun(one: str, other: str) -> bool:
    """Tell whether two nouns may name one road user: the city bus is the bus, no school bus."""
    return one == other or (
        one.rpartition(" ")[2] == other.rpartition(" ")[2]
        and " " not in (one, other)[len(one) > len(other)]
    )


class ClauseFacts:
    """The facts known at a hit: the clause's subject, the named road users, the plan.

    ``near`` is the road user that was named last in the clause, ``last`` the one that a pronoun
    means, ``void`` says that something else was named since, ``busy`` that the clause has its verb.
    """

    def __init__(self, words: list[str], hits: list[Hit], flags: list[Scope]) -> None:
        self.words, self.hits, self.flags = words, hits, flags
        self.known = lexicon()
        self.world = World()
        self.plan = Plan(words, self.world)
        self.last: Actor | None = None
        self.field = ""
        self.unit = self.step = 0
        self.listing = False
        self._at = 0
        self.denied: set[str] = set()  # kinds of road users that are absent
        self.was_in_path: tuple[Actor, Hit] | None = None  # who was said to be in our path
        self.subject: Actor | str | None = None
        self.named: list[Actor] = []
        self._begin(0, 0)

    def _begin(self, start: int, stop: int) -> None:
        self.start, self.stop = start, stop
        self.carried = self.subject
        self.subject = None
        self.near: Actor | None = None
        self.busy = False
        self.clause = start
        self.pending: list[tuple[int, Hit]] = []
        self.states: list[Hit] = []
        self.were_named = self.named
        self.named = []
        self.planned: list[Hit] = []
        self.reacting = False
        self.behind: Hit | None = None
        self.critical = False
        self.shows = self.because = self.void = False
        self.in_path = self.was_in_path
        self.was_in_path = None
        goes_on = not any(h.kind == "field" for h in self.hits[start : min(stop, start + REACH)])
        self.field = self.field if self._strong() and goes_on else ""

    def _before(self, index: int) -> Hit:
        return self.hits[index - 1] if index > self.start else NOTHING

    def _is_order(self, index: int) -> bool:
        """Tell whether a numbered step is one of a plan: an action stands first in it."""
        following = (
            hit for hit in self.hits[index + 1 : index + 5] if hit.kind not in ("mark", "field")
        )
        return next(following, NOTHING).kind in ("verb", "noun", "action")

    def _after(self, index: int, ahead: int = 1) -> Hit:
        return self.hits[index + ahead] if index + ahead < self.stop else NOTHING

    def _back(self, index: int, most: int) -> list[Hit]:
        """Return the hits before one in its sentence, the nearest first."""
        return self.hits[max(index - most, self.start) : index][::-1]

    def _said(self, value: str, hit: Hit) -> Statement:
        return Statement(value, hit.first, hit.stop, self.unit)

    def _line(self) -> int:
        return self.hits[self.start].first if self.start < len(self.hits) else 0

    def _attributed(self, index: int) -> bool:
        return self._before(index).kind in ("reacts", "goal", "verb")

    def _directed(self, index: int) -> bool:
        """Tell whether "to the left" is the goal of a movement, not a place."""
        first = self.hits[index].first
        if not self.words[first].startswith("to") or self.words[first + 1] in _OWNERS:
            return False
        for hit in self._back(index, 3):
            if hit.kind == "verb":
                signals = hit.value == "say" and self.hits[index].first == hit.stop
                return signals or self.known.verbs[hit.value].other in _LEADING_ON
            if hit.kind not in ("goal", "from", "towards"):
                return False
        return False

    def _owner(self) -> Actor | None:
        """Return the actor of an attribute: the noun of the clause, else its subject."""
        if self.near is not None:
            return self.near
        if isinstance(self.subject, Actor):
            return self.subject
        if self.field in ("position", "motion", "conflict"):
            return self.last
        return None

    def _other(self, index: int) -> bool:
        """Tell whether a place is relative to somebody else: in front of the bus."""
        at = self.hits[index].stop
        return any(
            hit.kind == "user" and hit.first - at < 4 for hit in self.hits[index + 1 : index + 4]
        )

    def _names_thing(self, index: int) -> bool:
        """Tell whether a word that no rule knows follows: behind railings."""
        hit, after = self.hits[index], self._after(index)
        word = self.words[hit.stop] if hit.stop < len(self.words) else "."
        return (
            word.isalpha()
            and after.first != hit.stop
            and word not in self.known.sets["words_behind_places"]
        )

    def _is_before_thing(self, hit: Hit) -> bool:
        """Tell whether a place is one before a thing: in front of a school."""
        return hit.value == "front" and _OWN.isdisjoint(self.words[hit.stop + 1 : hit.stop + 3])

    def _holds_more(self, index: int) -> bool:
        """Tell whether there is more in a clause that ends than places: the left lane is shut."""
        at = self.hits[index].first
        first = at
        while first > 0 and self.words[first - 1] not in MARKS:
            first -= 1
        if self.words[first] in self.known.sets["prepositions_of_place"]:
            return False  # on the crosswalk ahead of us, a lady
        covered = {
            word
            for hit in self._back(index, 6)
            if hit.kind in _DESCRIBING or hit.value in ("say", "open")
            for word in range(hit.first, hit.stop)
        }
        return any(
            word not in covered and self.words[word] not in self.known.sets["words_of_places"]
            for word in range(first, at)
        )

    def _is_passed(self, index: int) -> bool:
        """Tell whether a side is the one that we pass somebody on: overtake the bus on the left."""
        stop = self.hits[index].stop
        if self.words[stop - 3 : stop - 1] not in (["on", "the"], ["on", "our"], ["to", "the"]):
            return False
        commitments = (one for one in self.world.commitments if one.slot == "lat_action")
        if any(one.said.sentence == self.step for one in commitments):
            return False  # nudge left to pass the cyclist on the right
        for at in range(index - 1, max(index - 6, self.start - 1), -1):
            hit = self.hits[at]
            if hit.kind == "verb" and hit.value in ("overtake", "follow"):
                orders = self.subject in (None, EGO) and hit.form == "base" and not self.flags[at]
                return orders and self.words[hit.first] in ("pass", "overtake")
            if hit.kind not in ("user", "place", "state", "braked_in_lane", "verb"):
                return False
        return False

    def _had_to(self) -> bool:
        """Tell whether the VUT is said to have to act, earlier in the sentence."""
        return any(
            before.value == "must" and action in self.planned
            for before, action in pairwise(self.hits[self.start : self._at])
        )

    def _resumes(self, index: int, hit: Hit) -> bool:
        """Tell whether a participle alone goes on about who was named last: Van ahead. Waiting."""
        opens = index == self.start or self._before(index).value == ";"
        idle = not self.world.commitments and self.subject is None and self.near is None
        return opens and idle and hit.form == "ing" and not self.known.verbs[hit.value].ego

    def _is_ego(self, index: int, hit: Hit, user: Actor | None) -> bool:
        """Tell whether "the car" is the VUT: no other is named, or the text tells it what to do."""
        if hit.form != "the" or self.words[hit.first : hit.stop] not in (["car"], ["vehicle"]):
            return False
        article, before = self.words[hit.first - 1], self.words[hit.first - 2]
        if article != "the" or before in self.known.sets["prepositions_before_us"]:
            return False
        after = self.words[hit.stop] if hit.stop < len(self.words) else "."
        if after in self.known.sets["openers_of_attributes"] or after.endswith("ing"):
            return False
        if has_us(hit.stop, self.words):
            return False
        if self._is_passed_by_us(index, hit):
            return False
        following = self._after(index)
        if following.value == "must":
            return True
        beyond = self._after(index, 2)
        if following.value == "is":
            static = beyond.kind in ("place", "towards", "state", "conflict", "affects", "critical")
            moves = beyond.kind == "verb" and beyond.value not in ("go", "say")
            if static or (moves and not self.known.verbs[beyond.value].ego):
                return False
        return user is None or user.parked

    def _is_passed_by_us(self, index: int, hit: Hit) -> bool:
        """Tell whether a road user is the object of our verb: we overtake the car."""
        verb = self._before(index)
        ours = self.subject is EGO or (self.subject is None and verb.form == "base")
        adjacent = verb.stop == hit.first - 1
        return ours and adjacent and self.words[verb.first].startswith(PASSES)

    def _opens_clause(self, index: int) -> bool:
        """Tell whether a road user opens a clause of its own behind one of the VUT.

        It may have no conjunction: I notice a cyclist is crossing.
        """
        if self.subject is not EGO:
            return False
        places = 0
        while (
            self._after(index, 1 + places).kind in ("place", "braked_in_lane") and places < _PLACES
        ):
            places += 1
        last = self.hits[index + places]
        after, beyond = self._after(index, 1 + places), self._after(index, 2 + places)
        if after.value != "is" or after.first != last.stop:
            return False
        return beyond.kind != "user" and self._before(index).kind not in ("place", "user")

    def _reacted_to(self, index: int) -> bool:
        """Tell whether a commitment of the VUT stands right before: yield to the cyclist."""
        for hit in self._back(index, 3):
            if hit in self.planned:
                return self.hits[index].first - hit.stop < 7
            if hit.kind not in ("place", "state", "braked_in_lane", "reacts", "noun"):
                return False
        return False

    def _goes_by(self, index: int, hit: Hit, flags: Scope) -> bool:
        """Tell whether a verb is done because of somebody: I pass the parked truck."""
        if self.subject is None:
            return hit.value in ("follow", "overtake", "wait", "trail")
        passes = hit.value in ("overtake", "follow") and hit.form != "ed"
        parked = self.subject is EGO and self._after(index).value == "parked"
        return passes and parked and not flags & ~Scope.FUTURE

    def _orders_behind_reason(self, index: int) -> bool:
        """Tell whether an order stands behind the sentence's mark, and a reason opens it."""
        opened, after = self.hits[self.start], self._after(index)
        orders = after.kind == "verb" and after.form == "base"
        reason = opened.kind == "cue" and opened.value == "because"
        return reason and orders and after.first == self.hits[index].stop and not self.planned

    def _blocks(self, hit: Hit) -> bool:
        """Tell whether somebody is said to block a lane or road, not only a view."""
        word = self.words[hit.first]
        stands = hit.form in ("s", "ing") and word.startswith(("block", "obstruct"))
        return stands and hit.stop - hit.first > 1

    def _is_from_rear(self, hit: Hit) -> bool:
        """Tell whether "from behind" names nothing that it is behind of: a van from behind."""
        return self.words[hit.first : hit.stop] == ["from", "behind"] and (
            hit.stop >= len(self.words) or self.words[hit.stop] in _ENDS_PLACES
        )

    def _is_dismissed(self) -> bool:
        """Tell whether the sentence's heading dismisses what it lists: not critical: joggers."""
        heading = self.hits[self.start : min(self.start + 2, self.stop)]
        return heading[0].kind == "background" and heading[-1].value == ":"

    def _leads(self, index: int) -> bool:
        """Tell whether a place is where a movement leads: into the exit lane on the right."""
        hit, before = self.hits[index], self._before(index)
        return not _INTO.isdisjoint(self.words[max(before.stop, hit.first - 4) : hit.first])

    def _later(self, hit: Hit) -> bool:
        """Tell whether it is said when something is over: after the van has passed."""
        line = self.words[max(hit.first - 8, self._line()) : hit.first]
        return "after" in line and not _PASSED.isdisjoint(self.words[hit.first : hit.stop])

    def _is_of_named(self, hit: Hit) -> bool:
        """Tell whether a participle goes on about who was named: van: past us, and pulling away."""
        return (
            hit.form == "ing"
            and hit.value == "pull_away"
            and self.subject is None
            and bool(self.named)
            and not self.planned
        )

    def _is_bare_order(self, start: int, stop: int) -> bool:
        """Tell whether a sentence is an action of one or two words: Brake. Wait. Go."""
        first, *rest = self.hits[start:stop]
        return (
            first.kind in ("verb", "noun", "action")
            and [one.value for one in rest] == ["."]
            and rest[0].first - first.first <= _BARE
        )

    def _hindered(self, index: int, hit: Hit) -> bool:
        """Tell whether a road user blocks the manoeuvre: a bus is blocking a merge to the left."""
        for before in self._back(index, min(8, index - self.clause)):
            if before.kind == "matters":
                return True
            if before.kind in ("user", "cue"):
                break
        after = self._after(index)
        return after.kind == "matters" and after.first - hit.stop < 3

    def _gerund(self, index: int, hit: Hit) -> bool:
        """Braking sends a wave through the traffic; the reason for braking: no action is taken."""
        if hit.first and (
            self.words[hit.first - 1] in self.known.sets["prepositions_before_gerunds"]
        ):
            return True
        if self.subject is EGO or self.planned or self._strong():
            return False
        for after in self.hits[index + 1 : min(self.stop, index + REACH)]:
            if after.kind == "mark" and after.value != ",":
                return False
            if after.form == "s" or after.value in ("is", "may", "past"):
                return True
            if after.kind in ("user", "ego", "cue"):
                return False
        return False

    def _nobody_known(self, index: int) -> bool:
        """Tell whether a possible movement is that of somebody unseen: someone may walk out."""
        first = self.hits[index].first
        return not _UNSEEN.isdisjoint(self.words[max(first - 6, 0) : first])

    def _strong(self) -> bool:
        return self.field in ("lon_action", "lat_action", "action")

    def _adjoins(self, index: int) -> bool:
        kinds = [hit.kind for hit in self._back(index, 4)]
        return next((kind for kind in kinds if kind not in ("place", "state")), "") == "user"

    def _may(self, index: int) -> bool:
        """Tell whether it is may, could or might, not would, that makes a movement possible."""
        for hit in self._back(index, REACH):
            if hit.value == "may":
                return self.words[hit.first] not in self.known.sets["modals_without_risk"]
        return False

    def _goals(self, index: int) -> list[Hit]:
        """Return the places and directions that belong to a verb."""
        goals = []
        for hit in self._back(index, 5):
            if hit.kind == "from":
                goals.append(hit)
            elif hit.kind in ("verb", "ego") or (hit.kind == "cue" and hit.value != "is"):
                break
        for after in range(index + 1, min(index + 9, self.stop)):
            hit = self.hits[after]
            if hit.kind in _GOALS:
                goals.append(hit)
            elif hit.kind == "verb" and hit.form == "ing" and self.hits[after - 1].kind == "cue":
                continue
            elif hit.kind in ("verb", "user", "noun", "field") or hit.value in (
                ";",
                "so",
                "because",
                "but",
                "if",
                ".",
            ):
                break
        return goals

    def _with_cue(self, value: str, index: int, cues: tuple[str, ...]) -> Statement:
        """Return a statement that begins with its cue: could swerve, no risk."""
        hit = self.hits[index]
        for before in self.hits[max(self.clause, index - 4) : index]:
            if before.kind == "cue" and before.value in cues and hit.first - before.stop < 4:
                return Statement(value, before.first, hit.stop, self.unit)
        return self._said(value, hit)

    def _sentence(self) -> list[str]:
        first = self.hits[max(self.start, self._at - REACH)].first
        return self.words[first : self.hits[min(self.stop, self._at + REACH) - 1].stop]

    def _no_longer(self, hit: Hit) -> bool:
        around = " ".join(self.words[max(hit.first - 6, 0) : hit.stop + 4])
        return any(f" {end}" in f" {around}" for end in _ANY_MORE)

    def _is_a(self, index: int, hit: Hit) -> Actor | None:
        """Name an actor that was only called a vehicle: the vehicle that matters is a truck."""
        before, actor = self._before(index), self.subject
        if before.value in (":", "") and before.kind in ("mark", "field") and self.near is not None:
            is_generic = self.near.noun in _GENERIC and self._back(index, 3)[-1].kind == "user"
            if is_generic and hit.first - before.stop < 4:  # lead vehicle: a truck
                self.near.name = hit.value
                return self.near
        if hit.form not in ("a", "the") or before.value != "is" or hit.first - before.stop > 3:
            return None
        if not isinstance(actor, Actor) or actor.noun not in ("vehicle", "car"):
            return None
        actor.name = hit.value
        return actor

    def _noun_of(self, hit: Hit) -> tuple[str, str]:
        before = self.words[max(hit.first - 4, 0) : hit.first]
        colour = next((word for word in before if word in self.known.sets["colours"]), "")
        label = self.words[hit.stop] if hit.stop < len(self.words) else ""
        labels = [label] if label in self.known.sets["labels"] else []
        return " ".join([*self.words[hit.first : hit.stop], *labels]), colour

    def _known(self, hit: Hit) -> Actor | None:
        noun, colour = self._noun_of(hit)
        if hit.form == "another":
            return None
        single = noun.removesuffix("s")
        labelled = noun.rpartition(" ")[2] in self.known.sets["labels"]
        for actor in reversed(self.world.actors[-24:]):
            if labelled and actor.noun != noun:
                continue  # vehicle B isn't the vehicle
            if actor.noun.startswith(f"{noun} ") and actor.name == "cyclist":
                return actor  # a child on a bike: the child
            if (noun, actor.name) in _CALLED and hit.form == "the":
                return actor
            same = _same_noun(actor.noun.removesuffix("s"), single)
            generic = noun in _GENERIC or actor.noun in _GENERIC
            if (
                noun in ("vehicle", "vehicles")
                and hit.form == "the"
                and (actor.name not in PEOPLE and actor.name != "cyclist")
            ):
                return actor
            if actor.name == hit.value and (same or generic or actor.name in RIDERS):
                if colour and actor.colour and colour != actor.colour:
                    continue
                return actor
        return None

    def _identify(self, hit: Hit) -> Actor:
        noun, colour = self._noun_of(hit)
        user = self._known(hit)
        fresh = (
            hit.form == "a"
            and user is not None
            and (user in self.named or (user.noun != noun and user.name not in PEOPLE))
        )
        if user is not None and user.parked != any(one.value == "parked" for one in self.states):
            fresh = fresh or not user.parked or hit.form == "a"
        if user is not None and not fresh:
            user.colour = user.colour or colour
            return user
        last = self.words[hit.stop - 1]
        plural = last.endswith("s") or last in self.known.plurals
        actor = Actor(hit.value, len(self.world.actors), noun, colour, plural)
        self.world.actors.append(actor)
        return actor

    def _queues(self, index: int, flags: Scope) -> bool:
        """Tell whether "behind the van" is where the VUT is or stops, so that the van is ahead."""
        if flags & ~(Scope.REJECTED | Scope.INTENDED):
            return False
        hit = self.hits[index]
        for before in self._back(index, 6):
            if before.kind == "verb" and hit.first - before.stop < 8:
                meaning = self.known.verbs[before.value]
                return meaning.ego in _SPEED_ACTIONS or before.value in _STANDS
            if before.kind in ("user", "pronoun"):
                return False
        return False

    def _goes_on(self, index: int) -> bool:
        """Tell whether a verb stands right behind its subject, or behind "is"."""
        before = self._before(index)
        return before.kind in ("user", "pronoun", "relative") or before.value == "is"

    def _told_of(self, index: int) -> list[str]:
        """Return the words behind the "is" of a named conflict, or "has": with the van is low."""
        for at in range(index + 1, min(index + ENDS_WITHIN, self.stop)):
            hit = self.hits[at]
            if self.words[hit.first] in _PRESENT and not self.flags[at]:
                if hit.kind == "cue":
                    return self.words[hit.stop : hit.stop + 3]
                if hit.kind == "background":  # one phrase of the lexicon: "is gone"
                    return self.words[hit.first + 1 : hit.stop]
            if not _is_named_in_conflict(hit):
                break
        return []

    def _is_of_conflict(self, index: int) -> bool:
        """Tell whether "is gone" speaks of a named conflict, not of a road user."""
        for at in range(index - 1, max(index - ENDS_WITHIN, self.start) - 1, -1):
            if self.hits[at].kind in ("risk", "conflict"):
                return True
            if not _is_named_in_conflict(self.hits[at]):
                break
        return False

    def _has_ended(self, index: int) -> bool:
        """Tell whether the named conflict is over: the conflict with the van has now cleared."""
        words = self._told_of(index)
        return "not" not in words and not self.known.sets["ended"].isdisjoint(words)

    def _is_rated(self, index: int) -> bool:
        """Tell whether the named risk is said to be there: the risk with the truck is low."""
        words = self._told_of(index)
        return "not" not in words and not self.known.sets["rated"].isdisjoint(words)

    def _unless(self) -> bool:
        """Tell whether something happens unless something is done: without braking."""
        return not self.known.sets["words_of_certainty"].isdisjoint(self._sentence())


def _is_named_in_conflict(hit: Hit) -> bool:
    """Tell whether a hit may stand between a named conflict and its verb: with the parked van."""
    return hit.kind in _NAMED_IN_CONFLICT or hit.value in ("parked", "oncoming")
