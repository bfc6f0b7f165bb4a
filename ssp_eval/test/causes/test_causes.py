"""The causes of an answer: twins distinguish answerers whose cause is known."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ssp_core.vocabulary import ObjectClass
from ssp_eval.causes.answers import (
    Answer,
    Cause,
    CellAnswers,
    answers_of_cell,
    cause_of,
    comparable_cells,
)
from ssp_eval.causes.effects import TRAJECTORY, Effect, Verdict, effects_of
from ssp_eval.causes.findings import MovedAnswers, Word, compared, moved_by
from ssp_eval.causes.forest import forests
from ssp_eval.causes.tables import PATHS, SLOTS, moved_tables
from ssp_eval.evaluate.store.results import CellData
from ssp_eval.report.render import render
from ssp_eval.statistics.table import to_csv
from ssp_eval.twins.changes import usual_changes
from ssp_vla_bridge.trajectory import Trajectory
from tests.support.models.answerers import (
    ANSWERERS,
    CONDITIONS,
    GIVEN_BACK,
    LABELS,
    TURNED,
    Answerer,
    cells_of,
    unsteady,
)

REASONED = (*CONDITIONS, TURNED, GIVEN_BACK)
WORDS = {
    "uses_the_object": Word.OBJECT,
    "decides_first": Word.EXPLAINS_LATER,
    "only_talks": Word.EXPLAINS_LATER,
    "ignores_it": Word.IGNORES,
    "copies_its_history": Word.HISTORY,
    "looks_at_the_weather": Word.PICTURES,
}


def moved(
    answerer: Answerer, recordings: int = 20, conditions: Sequence[str] = CONDITIONS
) -> MovedAnswers:
    found = moved_by(cells_of("m", answerer, recordings, conditions))
    assert found is not None
    return found


def effect(found: MovedAnswers, cause: str, output: str) -> Effect:
    return next(e for e in found.effects if (e.cause.key, e.output) == (cause, output))


@pytest.mark.parametrize("noise", [0.0, 0.05])
@pytest.mark.parametrize("name", ANSWERERS)
def test_every_answerer_is_known_by_its_twins(name: str, noise: float) -> None:
    answerer = unsteady(ANSWERERS[name], noise, 0.6 * noise, seed=1)
    finding = moved(answerer, conditions=REASONED).findings[0]
    assert finding.word is WORDS[name]
    assert finding.tested


def test_without_its_text_given_back_nobody_can_tell_an_explanation_from_a_reason() -> None:
    first, later = (
        moved(ANSWERERS[name]).findings[0] for name in ("uses_the_object", "decides_first")
    )
    assert (first.word, first.text) == (later.word, later.text)
    assert "is the reason for its trajectory is unknown" in first.text
    # Where one part of the answer moves and the other doesn't, that tells it.
    assert moved(ANSWERERS["only_talks"]).findings[0].word is Word.EXPLAINS_LATER


def test_the_effect_of_an_object_has_the_size_that_it_was_given() -> None:
    found = moved(ANSWERERS["uses_the_object"])
    path = effect(found, "twin.without", TRAJECTORY)
    # Braking with 2 m/s² for 3 s: t² on a grid of 0.25 s, 3.39 m on average without t = 0, with
    # corners every 0.5 s; at 6 to 8 of 9 labels.
    assert path.verdict is Verdict.MOVED
    assert path.size is not None
    assert 3.4 * 6 / LABELS <= path.size <= 3.4 * 8 / LABELS
    assert path.per_metre == pytest.approx(path.size / 21.0, rel=0.1)
    assert path.changed_by_control == 0.0
    slot = effect(found, "twin.without", "lon_action")
    assert slot.verdict is Verdict.MOVED
    assert slot.test is not None
    assert (slot.recordings, slot.labels, slot.test.more) == (20, 20 * LABELS, 20)
    assert slot.p_holm == pytest.approx(slot.test.p * count_of_tests(found))
    assert effect(found, "twin.mirror", TRAJECTORY).verdict is Verdict.NONE
    assert effect(found, "twin.mirror", "position").verdict is Verdict.MOVED
    assert effect(found, "twin.without", "conflict").verdict is Verdict.NOT_GIVEN


def count_of_tests(found: MovedAnswers) -> int:
    return sum(e.test is not None and e.test.p_least < 1.0 for e in found.effects)


def null_campaign(numbers: np.random.Generator) -> Iterator[CellAnswers]:
    """A model that everything is alike to: its answers differ by chance, more so between cells."""
    for number in range(20):
        for condition in ("", *CONDITIONS):
            whole, far_m = numbers.integers(0, 2, 6), 10 + numbers.normal()
            answers: dict[float, Answer | None] = {}
            for label in range(LABELS):
                words = np.where(numbers.random(6) < 0.7, whole, numbers.integers(0, 2, 6))
                ahead_m = far_m + numbers.normal(0.0, 0.3)
                path = Trajectory((0.0, 1.0, 3.0), (0.0, ahead_m, 3 * ahead_m), (0.0, 0.0, 0.0))
                answers[label * 0.5] = Answer(tuple("ab"[w] for w in words), path, (None, None))
            name = f"event_{number}"
            yield CellAnswers("c", name, name, "simulation", "m", condition, answers)


def test_of_a_model_that_all_is_alike_to_hardly_any_campaign_finds_something() -> None:
    numbers = np.random.default_rng(1)
    found = [effects_of(null_campaign(numbers)) for _ in range(30)]
    by_chance = [any(e.p_holm is not None and e.p_holm <= 0.05 for e in of) for of in found]
    assert sum(by_chance) <= 3
    # Each test by itself finds something now and then, so that without the correction most would.
    assert sum(any(e.test.p <= 0.05 for e in of if e.test) for of in found) >= 10


def test_a_text_that_was_given_back_is_no_answer() -> None:
    found = moved(ANSWERERS["decides_first"], 2, REASONED)
    assert [e.output for e in found.effects if e.cause.family == "reasoning"] == [TRAJECTORY]
    (forest,) = forests(found.effects)
    assert (forest.rows[-1].text, forest.rows[-1].note) == (None, "given back")


def test_an_answer_that_changes_at_anything_is_put_down_to_nothing() -> None:
    restless = unsteady(ANSWERERS["uses_the_object"], 1.0, 0.0, seed=3)
    found = moved(restless)
    assert found.findings[0].word is Word.UNSTEADY
    assert not any(e.verdict is Verdict.MOVED for e in found.effects)


def test_a_few_recordings_are_shown_and_not_tested() -> None:
    found = moved(ANSWERERS["uses_the_object"], recordings=3)
    one = effect(found, "twin.without", TRAJECTORY)
    assert one.verdict is Verdict.UNTESTED
    assert not one.decidable
    assert one.interval.low is None
    assert not found.findings[0].tested
    assert "3 recordings can't support a test" in found.findings[0].text


def test_without_a_control_an_effect_is_described_and_not_tested() -> None:
    conditions = [name for name in CONDITIONS if ".control" not in name]
    found = moved(ANSWERERS["uses_the_object"], conditions=conditions)
    one = effect(found, "twin.without", "lon_action")
    assert (one.control, one.test, one.verdict) == ("", None, Verdict.UNCONTROLLED)
    assert one.size == one.changed
    assert found.findings[0].word is Word.OPEN
    assert "Differs with a change of the object (" in found.findings[0].text


def test_a_label_time_without_an_answer_is_left_out() -> None:
    cells = [*cells_of("m", ANSWERERS["uses_the_object"], 2)]
    kept = [one for cell in cells if (one := answers_of_cell(cell)) is not None]
    whole = compared(kept)
    gone = [
        replace(one, answers={**one.answers, 0.5: None})
        if one.condition == "twin.control.car"
        else one
        for one in kept
    ]
    less = compared(gone)
    assert whole is not None
    assert less is not None
    assert effect(whole, "twin.without", "objects").labels == 2 * LABELS
    assert effect(less, "twin.without", "objects").labels == 2 * (LABELS - 1)
    # Another family has a control of its own.
    assert effect(less, "pictures.fog.2", "objects").labels == 2 * LABELS


@pytest.mark.parametrize("far_m", [1e9, 1e303, 1.7e308])
@pytest.mark.parametrize("condition", ["", "repeat", "twin.control.car", "twin.without.ot1"])
def test_a_place_beyond_the_earth_is_compared_with_nothing(condition: str, far_m: float) -> None:
    kept = [
        one
        for cell in cells_of("m", ANSWERERS["uses_the_object"], 2)
        if (one := answers_of_cell(cell)) is not None
    ]
    far = Trajectory((0.0, 1.0, 2.0, 3.0), (0.0, far_m, -far_m, far_m), (0.0,) * 4)

    def answers(place: Trajectory | None) -> list[Effect]:
        return effects_of(
            [
                replace(one, answers={**one.answers, 0.5: replace(own, trajectory=place)})
                if one.condition == condition and (own := one.answers[0.5]) is not None
                else one
                for one in kept
            ]
        )

    of_far, of_none = ([e for e in x if e.output == TRAJECTORY] for x in map(answers, (far, None)))
    assert of_far == of_none
    one = next(e for e in of_far if e.cause.kind == "without")
    assert one.labels == 2 * (LABELS - 1)


def test_a_recording_that_several_campaigns_asked_about_is_one_unit() -> None:
    folders = (Path("first"), Path("second"))
    cells = [
        kept
        for folder in folders
        for cell in cells_of("m", ANSWERERS["uses_the_object"], 4, folder=folder)
        if (kept := answers_of_cell(cell)) is not None
    ]
    one = next(e for e in effects_of(cells) if e.output == TRAJECTORY)
    assert (one.recordings, one.labels) == (4, 2 * 4 * LABELS)


@pytest.mark.parametrize(
    ("condition", "cause", "words"),
    [
        ("twin.without.ot1", Cause("twin", "without"), "without the object"),
        ("twin.class.ot2.truck", Cause("twin", "class"), "another class in its place"),
        ("twin.shift.ot1.m0500", Cause("twin", "shift", "m0500"), "object 0.5 s earlier"),
        ("twin.shift.ot1.p0250", Cause("twin", "shift", "p0250"), "object 0.25 s later"),
        ("twin.history.0500", Cause("twin", "history", "0500"), "own history at 0.5 of the speed"),
        ("twin.control.car", Cause("twin", "control"), "a distant, irrelevant object"),
        ("pictures.low_light.2", Cause("pictures", "low_light", "2"), "low light, strong"),
        ("pictures.text_only", Cause("pictures", "text_only"), "text only"),
        ("black", Cause("pictures", "black"), "black"),
        ("reasoning.side", Cause("reasoning", "side"), "own text given back, side turned"),
        ("", None, ""),
        ("dimmed", None, ""),
    ],
)
def test_a_condition_says_its_cause(condition: str, cause: Cause | None, words: str) -> None:
    assert cause_of(condition) == cause
    assert cause is None or cause.words == words


def test_each_change_of_a_twin_is_a_cause_with_words_of_its_own() -> None:
    for change in usual_changes({"ot1": ObjectClass.CAR}):
        cause = cause_of(f"twin.{change.name}")
        assert cause is not None
        assert cause.kind == change.kind
        assert cause.words != cause.key


def test_of_an_ordinary_campaign_nothing_is_kept() -> None:
    names = ["s__d__m", "s__d__m+black", "s__d__other"]
    assert comparable_cells(names) == frozenset()
    assert comparable_cells([*names, "s__d__m+twin.mirror.ot1"]) == {
        "s__d__m",
        "s__d__m+black",
        "s__d__m+twin.mirror.ot1",
    }
    assert moved_by(cells_of("m", ANSWERERS["ignores_it"], 1, ("black",))) is None


def both(answerer: Callable[[str], Answerer]) -> list[CellData]:
    return [
        cell
        for name in ("uses_the_object", "ignores_it")
        for cell in cells_of(name, answerer(name), 12)
    ]


def test_the_tables_have_every_digit_and_the_page_its_section() -> None:
    cells = both(ANSWERERS.__getitem__)
    found = moved_by(cells)
    assert found is not None
    tables = {table.name: table for table in moved_tables(found)}
    rows = [*csv.DictReader(io.StringIO(to_csv(tables[PATHS])))]
    row = next(r for r in rows if r["condition"] == "twin.without" and r["verdict"] == "moved")
    assert row["model"] == "uses_the_object"
    assert (
        float(row["p_holm"])
        == effect(of_model(found, row["model"]), "twin.without", TRAJECTORY).p_holm
    )
    # Nobody here says a motion or a conflict, and who ignores the object says no position.
    assert len(tables[SLOTS].rows) == 5 * (4 + 3)
    page = render(cells, None, moved=found)
    section = page.split('<section id="moved">')[1].split("</section>")[0]
    assert "uses_the_object: uses the object" in section
    assert "ignores_it: ignores the object" in section
    assert section.count("<svg") == 2
    assert 'href="#moved"' in page
    assert 'id="moved"' not in render(cells, None)


def of_model(found: MovedAnswers, model: str) -> MovedAnswers:
    return replace(found, effects=tuple(e for e in found.effects if e.model == model))


def test_the_forest_has_every_cause_on_its_scale() -> None:
    (forest,) = forests(moved(unsteady(ANSWERERS["uses_the_object"], 0.05, 0.1, 5)).effects)
    assert [row.name for row in forest.rows] == [
        "object on the other side",
        "without the object",
        "frames from 0.5 s earlier",
        "own history at 0.5 of the speed",
        "fog, strong",
    ]
    for row in forest.rows:
        for mark in (row.path, row.text):
            assert mark is not None
            assert 0.0 <= mark.low <= mark.at <= mark.high <= 1.0
    assert forest.rows[1].path is not None
    assert forest.rows[1].path.look == "moved"
    assert forest.rows[3].path is not None
    assert forest.rows[3].path.look == "none"
