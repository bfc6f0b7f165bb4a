"""Texts that the rules can't read, because they aren't English, are said to be so."""

from __future__ import annotations

import json
import random
from pathlib import Path

import pytest

from ssp_core.cli import main
from ssp_eval.evaluate.store.answer_records import record_of
from ssp_eval.extract.language import foreign_language
from ssp_eval.extract.measure import load_corpus
from ssp_vla_bridge.messages import Response

CORPUS = Path(__file__).parents[1] / "corpus"
FOREIGN = [
    ("de", "Vor uns bremst ein Lastwagen, wir halten die Spur und bremsen."),
    ("de", "Der Fußgänger quert von rechts. Bremsen!"),
    ("de", "Spur halten, Tempo halten."),
    ("fr", "Un piéton traverse de la gauche; il faut freiner."),
    ("fr", "Garder la voie et maintenir la vitesse."),
    ("zh", "前方有行人横穿，减速。"),
    ("zh", "保持车道"),
    ("ja", "歩行者が横断しています。減速します。"),
    ("es", "El camión de la derecha se incorpora a nuestro carril."),
    ("es", "Mantener el carril y la velocidad."),
    ("ko", "보행자가 횡단 중입니다. 감속하세요."),
    ("ru", "Пешеход переходит слева, тормозим."),
    ("sv", "En fotgängare korsar från vänster, vi bromsar."),
]
TERSE = [
    "brake",
    "Brake.",
    "STOP",
    "keep lane, 12 m/s",
    "keep lane",
    "Maintain",
    "Continue",
    "yield",
    "slow down!",
    "Car left. Brake.",
    "STRAIGHT, MAINTAIN",
    "lon: decelerate | lat: straight",
    "no peds, no bikes, no cars. nobody at all. cruise.",
    "nan",
    "",
    "   ",
    "12.5",
    "[7.1, 0.0]",
    "ok",
    "go",
    "Decelerate. Decelerate. Decelerate.",
    "n/a",
    "ego: 8.3 m/s, a = -1.2 m/s²",
    '{"action": "stop", "lane": "keep"}',
    "Van → brake",
    "bus + cyclist",
]
WORDS = [
    "brake",
    "stop",
    "keep",
    "lane",
    "maintain",
    "accelerate",
    "decelerate",
    "left",
    "right",
    "straight",
    "yield",
    "car",
    "truck",
    "bus",
    "pedestrian",
    "cyclist",
    "ahead",
    "front",
    "merge",
    "slow",
    "cruise",
    "steer",
    "nudge",
    "hold",
    "continue",
    "go",
    "wait",
    "clear",
    "none",
    "no",
    "yes",
    "m/s",
    "12",
    "3.5",
    "ok",
    "risk",
    "object",
    "critical",
    "position",
    "motion",
    "plan",
]


@pytest.mark.parametrize(("language", "text"), FOREIGN)
def test_a_text_in_another_language_is_known(language: str, text: str) -> None:
    assert foreign_language(text) == language


@pytest.mark.parametrize("text", TERSE)
def test_terse_english_is_never_taken_for_another_language(text: str) -> None:
    assert foreign_language(text) is None


def test_no_text_of_the_corpora_is_taken_for_another_language() -> None:
    for file in ("test.jsonl", "development.jsonl"):
        for item in load_corpus(CORPUS / file):
            assert foreign_language(item.text) is None, item.id


def test_rows_of_driving_words_without_grammar_are_english() -> None:
    rng = random.Random(5)
    for _ in range(2_000):
        text = " ".join(rng.choice(WORDS) for _ in range(rng.randint(1, 7)))
        assert foreign_language(text) is None, text
        assert foreign_language(text.upper()) is None, text


def test_extract_says_which_texts_it_can_t_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "texts.jsonl"
    texts = [FOREIGN[0][1], "keep lane, 12 m/s", FOREIGN[5][1], FOREIGN[1][1]]
    lines = [json.dumps({"id": k, "text": text}) for k, text in enumerate(texts)]
    path.write_text("\n".join(lines), encoding="utf-8")
    assert main(["extract", str(path)]) == 0
    told = capsys.readouterr()
    found = [json.loads(line).get("language") for line in told.out.splitlines()]
    assert found == ["de", None, "zh", "de"]
    assert "texts in a language that the rules don't read: de 2, zh 1" in told.err


def test_a_record_says_it_in_its_notes() -> None:
    def notes(text: str) -> list[str]:
        record = record_of(0.0, Response("q", 0, "m", "m-1", text), "waypoints")
        assert record.adapter is not None
        found: list[str] = record.adapter["notes"]
        return [note for note in found if "language" in note]

    assert notes(FOREIGN[3][1]) == ["in a language that the rules don't read: fr"]
    assert notes("A car is ahead; we brake.") == []
