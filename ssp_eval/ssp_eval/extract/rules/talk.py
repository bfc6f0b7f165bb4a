"""Stage 5: who is being talked about, and the few questions that all readers ask."""

from __future__ import annotations

from ssp_eval.extract.rules.hits import Hit, Kind
from ssp_eval.extract.rules.plan.planner import Planner
from ssp_eval.extract.rules.scope.flags import Scope
from ssp_eval.extract.rules.world import Actor, Statement, World

EGO = "ego"
SCENE = "scene"
REACH = 24  # hits that a look along the sentence covers, so that the whole stays linear
_FIRST = frozenset({Kind.OBJECT, Kind.PRONOUN, Kind.SCENE, Kind.VERB})
CONNECTS = frozenset({Kind.AUX, Kind.JOIN, Kind.NOT, Kind.MODAL, Kind.THEN})
# A noun's place or state stays true whatever is planned or ruled out about the noun.
NOT_NOW = ~(Scope.READY | Scope.REJECTED | Scope.AHEAD | Scope.DENIED | Scope.POSSIBLE)
_ATTACHED = frozenset({Kind.PLACE, Kind.SIDE, Kind.STATE, Kind.IN_LANE})


class Talk:
    """What a careful reader keeps in mind while going through a text, hit by hit."""

    __slots__ = (
        "adjectives",
        "asked",
        "busy",
        "counted",
        "denied",
        "ego_is_car",
        "ego_named",
        "flags",
        "group",
        "heading",
        "hits",
        "in_path",
        "is_background",
        "key",
        "keyed",
        "last",
        "last_sentence",
        "listed",
        "listing",
        "named",
        "near",
        "number",
        "pending",
        "planner",
        "reacted",
        "reacting",
        "record",
        "revealing",
        "start",
        "stop",
        "subject",
        "topic",
        "under",
        "words",
        "world",
    )

    def __init__(self, words: list[str], hits: list[Hit], flags: list[int]) -> None:
        self.words, self.hits, self.flags = words, hits, flags
        self.world = World()
        self.planner = Planner(words, hits, flags, self.world)
        self.asked: list[Statement] = []  # places that a question was about
        self.last: Actor | None = None  # for pronouns: who was named last
        self.topic: Actor | None = None  # whom the sentence before was about
        self.ego_named = False
        self.ego_is_car = False  # the text may call the VUT "the car"
        self.key = ""  # field of a structured answer
        self.record: Actor | None = None  # whom a record of a structured answer describes
        self.under = False  # in the paragraph of such a heading
        self.listed = False  # the sentence before stood under such a heading
        self.counted = False  # several were announced: two of them deserve attention
        self.listing = False  # under a heading such as "Critical objects:"
        self.number = -1  # of the sentence
        self.start = self.stop = 0
        self.subject: Actor | str | None = None
        self.named: list[tuple[int, Actor]] = []
        self.begin(0, 0)

    def begin(self, start: int, stop: int) -> None:
        """Forgets the last sentence but for what pronouns and headings need."""
        if stop and self.named:
            self.topic = self.subject if isinstance(self.subject, Actor) else None
        self.last_sentence = self.start, self.stop, self.subject
        self.start, self.stop = start, stop
        self.subject = None
        self.near: Actor | None = None  # the noun last named in the clause
        self.group: list[Actor] = []  # nouns joined by and
        self.pending: list[int] = []  # places before their noun
        self.adjectives: list[int] = []  # states before their noun
        self.named = []
        self.heading = False  # the sentence has a heading for those who matter
        self.keyed = 0  # how many had been named when a record began
        self.denied: set[str] = set()
        self.busy = False  # the clause has its verb
        self.reacted = False  # and has been named
        self.reacting = False  # what is named next is what the plan is about
        self.in_path: tuple[Actor, int] | None = None
        self.is_background = False
        self.revealing = False  # hiding, blocking: who is named next matters too

    def after_ego(self) -> bool:
        """Whether the sentence before this one began or ended with the ego as its subject."""
        start, stop, subject = self.last_sentence
        if subject == EGO:
            return True
        for hit in self.hits[start : min(start + 4, stop)]:
            if hit.kind is Kind.EGO:
                return True
            if hit.kind in _FIRST:
                return False
        return False

    def target(self, index: int, hit: Hit) -> Actor | None:
        """Whom a finite verb or a participle speaks of."""
        previous = self.hits[index - 1] if index > self.start else None
        if previous is not None and previous.kind in CONNECTS and isinstance(self.subject, Actor):
            return self.subject
        if hit.form in ("base", "s") and isinstance(self.subject, Actor):
            return self.subject
        if self.near is not None and self.subject is not EGO:
            return (
                self.near
                if not isinstance(self.subject, Actor) or not self.busy
                else (self.near if self.adjoins(index) else self.subject)
            )
        if self.near is not None and self.adjoins(index):
            return self.near
        if isinstance(self.subject, Actor):
            return self.subject
        if self.record is not None and self.key in ("motion", "position"):
            return self.record
        return self.world.loose if self.key in ("motion", "position", "conflict") else None

    def adjoins(self, index: int) -> bool:
        """Whether only places stand between a word and the noun before it."""
        for before in range(index - 1, max(index - 4, self.start - 1), -1):
            kind = self.hits[before].kind
            if kind in (Kind.OBJECT, Kind.PRONOUN, Kind.RELATIVE):
                return True
            if kind not in (Kind.PLACE, Kind.SIDE, Kind.STATE):
                return False
        return False

    def attached(self, index: int) -> bool:
        """Whether only places and a participle stand between: the bus rolling ahead."""
        for before in range(index - 1, max(index - 4, self.start - 1), -1):
            hit = self.hits[before]
            if hit.kind is Kind.OBJECT:
                return True
            if hit.kind not in _ATTACHED and not (hit.kind is Kind.VERB and hit.form == "ing"):
                return False
        return False

    def flags_at(self, index: int) -> int:
        """What is in force at an attribute; at its noun's side it is as true as the noun is."""
        if self.near is not None and self.named and self.attached(index):
            return self.flags[index] & self.flags[self.named[-1][0]]
        return self.flags[index]

    def spoken_of(self) -> Actor | None:
        """Who was named last and not put aside."""
        if self.last is None or not self.last.background:
            return self.last
        recent = reversed(self.world.actors[-REACH:])
        return next((one for one in recent if one.mentions and not one.background), self.last)

    def put(self, actor: Actor, index: int, flags: int) -> None:
        if flags & NOT_NOW or (flags and actor is not self.near):
            return
        hit = self.hits[index]
        actor.places.append(self.said(hit.value, hit))
        self.show(actor, index)

    def show(self, actor: Actor, index: int) -> None:
        """An asserted attribute makes a road user present that was only named before."""
        if not actor.mentions and actor.first_named is not None and not self.flags[index]:
            actor.mentions.append(actor.first_named)

    def conflicted(self) -> Actor:
        """With whom a conflict is that is spoken of: the subject, or whom the clause named."""
        if isinstance(self.subject, Actor):
            return self.subject
        return self.near or self.world.loose

    def said(self, value: str, hit: Hit, stop: int | None = None) -> Statement:
        return Statement(value, hit.first, stop or hit.stop, self.number)

    def clear(self) -> None:
        self.subject = None
        self.near = None
        self.busy = False
        self.pending, self.adjectives = [], []
        self.is_background = False
