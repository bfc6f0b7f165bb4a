"""The corpus format and the measure over it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_eval.data.records import SLOT_NAMES, Slot, Slots
from ssp_eval.extract.measure import measure, parse_corpus


def line(key: str = "x1", text: str = "A car. I stop.", style: str = "coc", **slots: Any) -> str:
    whole = dict.fromkeys(SLOT_NAMES) | slots
    return json.dumps({"id": key, "style": style, "text": text, "slots": whole})


STOP = {"value": "stop", "evidence": [[9, 13]]}
CAR = {"value": ["car"], "evidence": [[0, 5]]}


def test_a_good_corpus() -> None:
    examples = parse_corpus(line(lon_action=STOP) + "\n\n" + line("x2", objects=CAR), "c.jsonl")
    assert [one.key for one in examples] == ["x1", "x2"]
    assert examples[0].slots.lon_action == Slot("stop", ((9, 13),))
    assert examples[1].slots.objects == Slot(("car",), ((0, 5),))


@pytest.mark.parametrize(
    ("content", "place"),
    [
        (line(style="poem"), "c.jsonl:1: style"),
        (line(lon_action=STOP | {"evidence": []}), "lon_action.evidence"),
        (line(lon_action=STOP | {"evidence": [[9, 15]]}), "lon_action.evidence[0]"),
        (line(lon_action=STOP | {"evidence": [[13, 9]]}), "lon_action.evidence[0]"),
        (line(lon_action=STOP | {"evidence": [[1, 2]]}), "blanks"),
        (line(lon_action=STOP | {"evidence": [[1]]}), "lon_action.evidence[0]"),
        (line(lon_action=STOP | {"evidence": [[True, 4]]}), "evidence[0][0]"),
        (line(lon_action=STOP | {"value": "halt"}), "lon_action.value"),
        (line(lon_action=STOP | {"value": ["stop"]}), "lon_action.value"),
        (line(objects=CAR | {"value": "car"}), "objects.value"),
        (line(objects=CAR | {"value": ["car", "car"]}), "twice"),
        (line(lon_action=STOP | {"quotes": []}), "lon_action.quotes"),
        (line(speed=None), "slots.speed"),
        (line(key=""), "id"),
        (line() + "\n" + line(), "c.jsonl:2: id"),
        ("", "no text"),
        ("{", "JSON"),
        ("[]", "dictionary"),
    ],
)
def test_a_wrong_line_is_named(content: str, place: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_corpus(content, "c.jsonl")
    assert place in str(caught.value)


def test_counts_by_slot_style_class_and_span() -> None:
    examples = parse_corpus(
        "\n".join(
            [
                line("a", lon_action=STOP, objects=CAR),
                line("b", style="terse", lon_action=STOP, objects=CAR),
                line("c", style="terse"),
                line("d", lon_action=STOP),
            ]
        ),
        "c.jsonl",
    )
    given = iter(
        [
            Slots(lon_action=Slot("stop", ((9, 13),)), objects=Slot(("car", "bus"), ((2, 5),))),
            Slots(lon_action=Slot("stop", ((7, 13),)), objects=Slot(("car",), ((6, 7),))),
            Slots(lon_action=Slot("maintain", ((9, 13),)), objects=Slot((), ((0, 5),))),
            Slots(),
        ]
    )
    found = measure(examples, lambda _: next(given))
    score = found.slots["lon_action"]
    assert (score.given, score.wanted, score.right) == (3, 3, 2)
    assert score.precision.value == pytest.approx(2 / 3)
    assert score.f1 == pytest.approx(2 / 3)
    assert found.spans["lon_action"] == {"inside": 1, "overlapping": 1, "elsewhere": 0}
    assert found.spans["objects"] == {"inside": 0, "overlapping": 0, "elsewhere": 1}
    assert found.confusion["lon_action"] == {
        ("stop", "stop"): 2,
        ("–", "maintain"): 1,
        ("stop", "–"): 1,
    }
    assert found.confusion["objects"] == {
        ("car", "car+bus"): 1,
        ("car", "car"): 1,
        ("–", "nobody"): 1,
        ("–", "–"): 1,
    }
    assert vars(found.classes["car"]) == {"given": 2, "wanted": 2, "right": 2}
    assert vars(found.classes["bus"]) == {"given": 1, "wanted": 0, "right": 0}
    assert vars(found.styles["terse"]["all"]) == {"given": 4, "wanted": 2, "right": 2}
    assert vars(found.slots["all"]) == {"given": 6, "wanted": 5, "right": 3}
    assert [(one.key, one.slot) for one in found.misses] == [
        ("a", "objects"),
        ("c", "objects"),
        ("c", "lon_action"),
        ("d", "lon_action"),
    ]
    assert found.slots["conflict"].f1 is None


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "corpus.jsonl"
    path.write_text(line(lon_action=STOP, conflict={"value": "active", "evidence": [[0, 5]]}))
    assert main(["extract", "--measure", str(path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["slots"]["lon_action"]["precision"] == 1.0
    assert found["slots"]["conflict"]["recall"] == 0.0
    assert found["slots"]["conflict"]["recall_95"][1] > 0.7
    assert main(["extract", "--measure", str(path), "--misses"]) == 0
    assert "x1  conflict: wanted active, given –" in capsys.readouterr().out


@pytest.mark.parametrize(
    "given",
    [
        [],
        ["a.jsonl", "--measure", "b.jsonl"],
        ["a.jsonl", "--json"],
        ["a.jsonl", "--key", "k.json"],
        ["--returned", "a", "b"],
        ["a.jsonl", "--review", "o", "--measure", "b"],
        ["-", "--review", "o"],
        ["a.jsonl", "--base-url", "http://localhost:1/v1"],
        ["a.jsonl", "--llm", "m"],
        ["a.jsonl", "--llm", "m", "--base-url", "localhost"],
    ],
)
def test_options_that_dont_go_together(given: list[str]) -> None:
    assert main(["extract", *given]) == 2
