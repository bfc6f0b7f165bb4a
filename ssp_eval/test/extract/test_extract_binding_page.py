"""The page on binding names the whole state of the reading, and its sentences are read as it says.

A table that differs is printed as it should stand.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from ssp_eval.extract import engine
from ssp_eval.extract.bind import Binder
from ssp_eval.extract.clause import ClauseFacts
from ssp_eval.extract.match import Hit
from ssp_eval.extract.scope import Scope
from ssp_eval.extract.world import Actor, World

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "binding.md").read_text()
SENTENCE = re.compile(r"^> (.+)\n\n((?:\|.*\n)+)\n(.+)$", re.M)
SENTENCES = [found.groups() for found in SENTENCE.finditer(PAGE)]
HEAD = "| words | kind | in force | `subject` | `near` | `last` | waiting | added |\n" + "|---" * 8
SLOTS = ("objects", "position", "motion", "conflict", "lon_action", "lat_action")


def statements(world: World) -> list[str]:
    """Return the world's content in words; it only grows."""
    found = [f"{commitment.slot} {commitment.said.value}" for commitment in world.commitments]
    found += [f"conflict {said.value}" for said in world.loose]
    for actor in world.actors:
        found.append(f"a {actor.name}")
        for kind, said in (
            ("is", actor.places),
            ("moves", actor.motions),
            ("conflict", actor.conflicts),
        ):
            found += [f"{actor.name} {kind} {one.value}" for one in said]
        found += [f"{actor.name} is reacted to"] if actor.reaction == 2 else []
    return found


def name_of(one: Actor | str | None) -> str:
    return one.name if isinstance(one, Actor) else (one or "")


class Traced(Binder):
    """A reading that keeps a row of a table for each hit."""

    rows: list[str]

    def _read(self, index: int, hit: Hit, flags: Scope) -> None:
        before = statements(self.world)
        super()._read(index, hit, flags)
        waiting = [*(one for _, one in self.pending), *self.states]
        cells = (
            " ".join(self.words[hit.first : hit.stop]),
            f"{hit.kind} `{hit.value}`" if hit.value and hit.kind != "mark" else hit.kind,
            "|".join(flag.name or "" for flag in flags).lower(),
            name_of(self.subject),
            name_of(self.near),
            name_of(self.last),
            ", ".join(one.value for one in waiting),
            "; ".join(one for one in statements(self.world) if one not in before),
        )
        self.rows.append("| " + " | ".join(cells) + " |")


def read(text: str, patch: pytest.MonkeyPatch) -> tuple[str, str]:
    """Return a sentence's table and its slots, as the page has them."""
    rows: list[str] = []
    patch.setattr(Traced, "rows", rows, raising=False)
    patch.setattr(engine, "Binder", Traced)
    slots = engine.read(text).slots
    given = [(name, slot.value) for name in SLOTS if (slot := getattr(slots, name)) is not None]
    values = [(name, one if isinstance(one, str) else "+".join(sorted(one))) for name, one in given]
    table = "\n".join((f"{HEAD}|", *(re.sub(r" +", " ", row) for row in rows)))
    return f"{table}\n", "Slots: " + ", ".join(f"{name} `{one}`" for name, one in values) + "."


@pytest.mark.parametrize(("text", "table", "slots"), SENTENCES, ids=[one[0] for one in SENTENCES])
def test_a_sentence_of_the_page_is_read_as_it_says(
    text: str, table: str, slots: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    wanted = read(text, monkeypatch)
    assert (table, slots) == wanted, "\n".join(wanted)


def test_the_page_reads_sentences() -> None:
    assert len(SENTENCES) >= 4


def of_reading() -> list[str]:
    """Return the attributes that change while a text is read."""
    text = {"words", "hits", "flags", "known"}
    return sorted(set(vars(ClauseFacts([], [], []))) - text)


@pytest.mark.parametrize("name", of_reading())
def test_the_page_explains_each_part_of_the_state(name: str) -> None:
    rows = [line for line in PAGE.splitlines() if line.startswith("| `")]
    assert any(f"`{name}`" in row.split(" | ")[0] for row in rows)
