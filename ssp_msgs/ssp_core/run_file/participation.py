"""The participants of a session and their kinds: real, simulated or played (METHOD 4.4b).

Each participant of a live session declares its kind in a latched message on a topic of its own.
Programs of this project declare ``simulated`` or ``played`` in code, and nothing for what they hear
over a wire. A session that isn't live has a simulated world, whatever its site file says.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING

from ssp_core.names import VUT_ID

if TYPE_CHECKING:
    from ssp_core.run_file.model import RunSpec

POSITIONING, CAMERA = f"{VUT_ID}/positioning", f"{VUT_ID}/camera"


class ParticipantKind(StrEnum):
    """The kind of a participant."""

    REAL = "real"  # a device or a vehicle
    SIMULATED = "simulated"  # a model of motion or of light
    PLAYED = "played"  # a recording


class Standing(StrEnum):
    """The kind of a session, by its participants."""

    REAL = "real"
    STAND_IN = "stand-in"
    UNDECLARED = "undeclared"


def body_of(object_id: str) -> str:
    """Name of the participant that moves an object."""
    return f"{object_id}/body"


def declaring(run: RunSpec) -> tuple[str, ...]:
    """List the names of all participants of a live session that must declare their kind.

    The run file of a session lists them; another file's are those that any live run has.
    """
    return run.declaring or participants(
        [target.id for target in run.targets], has_camera=run.camera is not None
    )


def participants(object_ids: Iterable[str], *, has_camera: bool) -> tuple[str, ...]:
    """List the names of the participants that a live run has at least."""
    objects = [name for object_id in object_ids for name in (object_id, body_of(object_id))]
    camera = (CAMERA,) if has_camera else ()
    return (VUT_ID, POSITIONING, *camera, *objects)


@dataclass(frozen=True, slots=True)
class Participation:
    """The kinds of a session's participants.

    Args:
        mode: of the session.
        declared: by participant, every kind that it declared; empty: none.
        word: by participant, the kind by the word of a named person.
        said_by: who gave that word, with date and place; empty: none was given.
        lost: participants whose declarations the recorder wrote, and which the bag lacks; no
            person's word counts for them.
    """

    mode: str
    declared: Mapping[str, tuple[str, ...]]
    word: Mapping[str, str] = field(default_factory=dict)
    said_by: str = ""
    lost: tuple[str, ...] = ()

    @property
    def silent(self) -> tuple[str, ...]:
        """Participants that declared nothing and for which no person declared anything."""
        if self.mode != "live":
            return ()
        return tuple(who for who in self.declared if not self.kinds_of(who))

    @property
    def substitutes(self) -> tuple[str, ...]:
        """Participants that were simulated or played."""
        real = {ParticipantKind.REAL}
        return tuple(who for who in self.declared if {*self.kinds_of(who)} - real)

    @property
    def contradictions(self) -> tuple[str, ...]:
        """Sentences about participants that declared two different kinds."""
        return contradictions(self.declared)

    @property
    def standing(self) -> Standing:
        """Return the kind of the session."""
        if self.mode != "live" or self.substitutes:
            return Standing.STAND_IN
        return Standing.UNDECLARED if self.silent else Standing.REAL

    def kinds_of(self, who: str) -> tuple[str, ...]:
        """Return the kinds that a participant declared, by a person's word where there are none."""
        kinds = self.declared.get(who, ())
        has_word = who in self.word and who not in self.lost
        return kinds or ((self.word[who],) if has_word else ())

    @property
    def text(self) -> str:
        """The participants by kind, and whose word it is, for people."""
        if self.mode != "live":
            return f"a simulated world ({self.mode})"
        groups = [
            (kind, [who for who in self.declared if kind in self.kinds_of(who)])
            for kind in ParticipantKind
        ]
        parts = [f"{kind}: {', '.join(of)}" for kind, of in groups if of]
        if self.silent:
            parts.append(f"undeclared: {', '.join(self.silent)}")
        if self.lost:
            parts.append(f"declared, and missing in this bag: {', '.join(self.lost)}")
        if self.said_by:
            by_word = [who for who in self.word if not self.declared.get(who)]
            counted = [who for who in by_word if who not in self.lost]
            names_text = ", ".join(counted) or "none, since all declared themselves"
            parts.append(f"by the word of {self.said_by}: {names_text}")
        return "; ".join(parts)


def contradictions(declared: Mapping[str, Iterable[str]]) -> tuple[str, ...]:
    """List sentences about participants that declared two different kinds."""
    listed = {who: list(dict.fromkeys(kinds)) for who, kinds in declared.items()}
    return tuple(
        f"{who} is declared {' and '.join(kinds)}"
        for who, kinds in listed.items()
        if len(kinds) > 1
    )


def stands_in(run: RunSpec, part: Participation) -> bool:
    """Return True for a physical session that is a stand-in, by its site or by its participants."""
    return run.domain == "physical" and (run.stand_in or part.standing is Standing.STAND_IN)
