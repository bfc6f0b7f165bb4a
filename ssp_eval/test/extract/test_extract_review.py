"""The blind review: which texts, what reviewers get to see, and what comes of their answers."""

from __future__ import annotations

import base64
import json
import math
import random
import re
import subprocess
import tempfile
from collections import Counter
from pathlib import Path

import pytest

from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_eval.data.records import SLOT_NAMES
from ssp_eval.extract import extract
from ssp_eval.extract.review.agreement import Z_95, cohens_kappa, compare
from ssp_eval.extract.review.answers import ANSWERS_SCHEMA, KeyItem, load_answers, load_key
from ssp_eval.extract.review.form import form
from ssp_eval.extract.review.subset import Candidate, choose

CHROMIUM = [
    "chromium",
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
COMMON = "A car is ahead. Brake."
TEXTS = [
    *(f"{COMMON} Sentence {number} says nothing." for number in range(40)),
    "A cyclist is crossing from the left. Stop.",
    "A bus is behind us. Accelerate.",
    "Blue sky over the <b>hills</b> & </script><script>document.title='broken'</script>",
    "=1+1 is no formula",
    COMMON,
    COMMON,
]


def write_texts(folder: Path) -> Path:
    path = folder / "texts.jsonl"
    lines = [json.dumps({"id": f"secretmodel/{i}", "text": t}) for i, t in enumerate(TEXTS)]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


@pytest.fixture
def review(tmp_path: Path) -> Path:
    out = tmp_path / "review"
    assert main(["extract", str(write_texts(tmp_path)), "--review", str(out), "--n", "12"]) == 0
    return out


def filled(review: Path, reviewer: int, **changes: str) -> Path:
    """Write a reviewer's answers, equal to the extractor's but for changes to the first text."""
    key = load_key(review / "key.json")
    by_id = {item.review_id: dict(item.extracted) for item in key.items}
    by_id[key.items[0].review_id] |= changes
    value = {
        "schema": ANSWERS_SCHEMA,
        "subset": key.subset,
        "reviewer": reviewer,
        "answers": {name: {**one, "comment": ""} for name, one in by_id.items()},
    }
    path = review / f"answers_{reviewer}.json"
    path.write_text(json.dumps(value))
    return path


def test_rare_values_and_empty_slots_are_drawn() -> None:
    candidates = [Candidate(i, text, extract(text)) for i, text in enumerate(TEXTS)]
    chosen = choose(candidates, 8, 0)
    texts = {one.text for one in chosen}
    assert len(texts) == len(chosen) == 8
    assert TEXTS[40:43] == [text for text in TEXTS[40:43] if text in texts]
    drawn = Counter(stratum for one in chosen for stratum in one.strata)
    assert all(drawn[name, "none"] for name in SLOT_NAMES)
    assert [one.source_id for one in choose(candidates, 8, 0)] == [c.source_id for c in chosen]
    assert [one.source_id for one in choose(candidates, 8, 1)] != [c.source_id for c in chosen]
    assert len(choose(candidates, 500, 0)) == len(set(TEXTS))


def test_reviewers_see_texts_under_new_ids_and_nothing_else(review: Path) -> None:
    orders = []
    for reviewer in (1, 2):
        folder = review / f"reviewer_{reviewer}"
        page = (folder / "form.html").read_text(encoding="utf-8")
        data = json.loads(page.split('type="application/json">')[1].split("</script>")[0])
        ids = [one["id"] for one in data["texts"]]
        orders.append(ids)
        assert set(data["texts"][0]) == {"id", "text"}
        assert "secretmodel" not in page
        assert "extracted" not in page
        assert not re.search(r'(src|href)=(?!"data:)|@import|https?://', page)
        assert {path.name for path in folder.iterdir()} == {"form.html"}
    first = [item.review_id for item in load_key(review / "key.json").items]
    assert [key[-4:] for key in first] == [f"-{n:03d}" for n in range(1, 13)]
    assert sorted(orders[0]) == sorted(orders[1]) == first
    assert orders[0] != orders[1]


def test_a_text_cannot_leave_the_form() -> None:
    page = form({"r001": TEXTS[42], "r002": "half \ud800 a pair"}, "sha256:0", 1)
    assert page.count("</script>") == 2
    assert "half ? a pair" in page


@pytest.mark.programs
def test_the_form_is_answered_by_keys_and_exports_what_is_read_back(
    review: Path, tmp_path: Path
) -> None:
    drive = """<script>
    const key = (k) => document.dispatchEvent(new KeyboardEvent("keydown", {key: k}));
    ids.forEach(() => ["2", "5", "Enter", "2", "Enter", "0", "Enter", "3", "Enter", "2", "Enter",
                       "1", "3", "Enter"].forEach(key));
    document.body.replaceChildren(Object.assign(document.createElement("pre"),
      {id: "out", textContent: btoa(JSON.stringify([asFile(given()), document.title]))}));
    </script></body>"""
    page = (review / "reviewer_1" / "form.html").read_text(encoding="utf-8")
    path = tmp_path / "driven.html"
    path.write_text(page.replace("</body>", drive), encoding="utf-8")
    with tempfile.TemporaryDirectory() as profile:
        done = subprocess.run(
            [*CHROMIUM, f"--user-data-dir={profile}", "--dump-dom", path.as_uri()],
            capture_output=True,
            text=True,
            timeout=600,
            check=True,
        )
    found = re.search(r'<pre id="out">([^<]+)<', done.stdout)
    assert found, done.stdout[-2000:]
    as_json, title = json.loads(base64.b64decode(found[1]))
    assert title == "Review 1: 12 texts"
    (tmp_path / "a.json").write_text(as_json, encoding="utf-8")
    answered = load_answers(tmp_path / "a.json", load_key(review / "key.json"))
    assert set(map(tuple, (one.values() for one in answered.values()))) == {
        ("truck+cyclist", "front_left", "none", "active", "decelerate", "right")
    }


def test_nothing_is_written_over(review: Path, tmp_path: Path) -> None:
    before = (review / "key.json").read_bytes()
    assert main(["extract", str(write_texts(tmp_path)), "--review", str(review)]) == 1
    assert (review / "key.json").read_bytes() == before


def test_agreement_errors_and_what_to_settle(
    review: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    item = load_key(review / "key.json").items[0]
    extracted = item.extracted
    shared = "oncoming" if extracted["motion"] != "oncoming" else "receding"
    first = filled(review, 1, motion=shared, conflict="active", position="unsure")
    second = filled(review, 2, motion=shared, conflict="none")
    capsys.readouterr()
    given = ["extract", "--returned", str(first), str(second), "--key", str(review / "key.json")]
    assert main([*given, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["texts"] == 12
    assert {(one["review_id"], one["slot"]) for one in found["disagreements"]} == {
        (item.review_id, "conflict"),
        (item.review_id, "position"),
    }
    [error] = found["errors"]
    kind = "false_negative" if extracted["motion"] == "none" else "wrong"
    assert (error["review_id"], error["slot"], error["kind"]) == (item.review_id, "motion", kind)
    assert error["source_id"].startswith("secretmodel/")
    slots = found["slots"]
    assert slots["motion"]["agreement"] == 1.0
    assert slots["conflict"]["agreement"] == pytest.approx(11 / 12)
    assert (slots["position"]["judged"], slots["position"]["unsure"]) == (11, 1)
    assert slots["objects"]["extractor"]["precision"] == 1.0
    assert slots["objects"]["object_overlap"] == 1.0
    assert main(given) == 0
    shown = capsys.readouterr().out
    assert item.review_id in shown
    assert "To settle" in shown


@pytest.mark.parametrize(
    ("slot", "written"),
    [
        ("motion", "flying"),
        ("motion", ""),
        ("objects", "car+nobody"),
        ("objects", "car+dog"),
        ("objects", "+"),
        ("position", "nobody"),
        ("mood", "grim"),
    ],
)
def test_answers_are_read_strictly(review: Path, slot: str, written: str) -> None:
    path, key = filled(review, 1, **{slot: written}), load_key(review / "key.json")
    with pytest.raises(InputError, match=slot) as caught:
        load_answers(path, key)
    assert key.items[0].review_id in str(caught.value)


def test_classes_have_one_order(review: Path) -> None:
    key = load_key(review / "key.json")
    found = load_answers(filled(review, 1, objects="pedestrian+car"), key)
    assert found[key.items[0].review_id]["objects"] == "car+pedestrian"


def test_a_missing_text_and_another_reviews_answers_are_refused(
    review: Path, tmp_path: Path
) -> None:
    path, key = filled(review, 1), load_key(review / "key.json")
    value = json.loads(path.read_text())
    gone = {**value, "answers": dict(list(value["answers"].items())[1:])}
    strange = {
        **value,
        "answers": {**value["answers"], "r0": value["answers"][key.items[0].review_id]},
    }
    for given, told in (
        (gone, "has no answers for r"),
        (strange, "is no text of this review"),
        ({**value, "subset": "sha256:1"}, "another review"),
    ):
        path.write_text(json.dumps(given))
        with pytest.raises(InputError, match=told):
            load_answers(path, key)


def test_kappa_of_a_known_table() -> None:
    # 50 questions, 20 yes-yes, 15 no-no, 5 and 10 mixed: p_o = 0.7, p_e = 0.5.
    pairs = [("y", "y")] * 20 + [("y", "n")] * 5 + [("n", "y")] * 10 + [("n", "n")] * 15
    kappa = cohens_kappa(pairs)
    assert kappa.value == pytest.approx(0.4)
    assert kappa.interval is not None


@pytest.mark.parametrize("seed", range(4))
def test_the_interval_of_kappa_is_that_of_its_gradient(seed: int) -> None:
    """The delta method with numerical derivatives gives the same standard error."""
    rng = random.Random(seed)
    labels = ["a", "b", "c"]
    pairs = [
        (one, one if rng.random() < 0.6 else rng.choice(labels))
        for one in rng.choices(labels, [3, 2, 1], k=200)
    ]

    def value(cells: dict[tuple[str, str], float]) -> float:
        whole = sum(cells.values())
        equal = sum(cells[x, x] for x in labels) / whole
        chance = sum(
            sum(cells[x, y] for y in labels) * sum(cells[y, x] for y in labels) for x in labels
        )
        return (equal - chance / whole**2) / (1 - chance / whole**2)

    counts = Counter(pairs)
    shares = {(x, y): counts[x, y] / 200 for x in labels for y in labels}
    slopes = {}
    for cell in shares:
        up, down = dict(shares), dict(shares)
        up[cell] += 1e-6
        down[cell] -= 1e-6
        slopes[cell] = (value(up) - value(down)) / 2e-6
    mean = sum(shares[cell] * slopes[cell] for cell in shares)
    error = math.sqrt(sum(shares[c] * (slopes[c] - mean) ** 2 for c in shares) / 200)
    kappa = cohens_kappa(pairs)
    assert kappa.value == pytest.approx(value(shares))
    assert kappa.interval == pytest.approx(
        (value(shares) - Z_95 * error, value(shares) + Z_95 * error), abs=1e-6
    )


def test_kappa_has_no_sense_where_nothing_varies() -> None:
    assert cohens_kappa([("a", "a")] * 5).value is None
    assert cohens_kappa([]).interval is None
    assert cohens_kappa([("a", "b"), ("b", "a")]).value == pytest.approx(-1.0)


def test_classes_that_both_named() -> None:
    nothing = dict.fromkeys(SLOT_NAMES, "none")
    items = [KeyItem(review_id="r1", source_id=1, text_sha256="", extracted=nothing)]
    one = {"r1": nothing | {"objects": "car+bus"}}
    other = {"r1": nothing | {"objects": "car"}}
    assert compare(items, one, other).slots["objects"].overlap == pytest.approx(0.5)
