"""``ssp audit observe`` and ``agree``: page, template, sealing, the log."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, get_args

import pytest
from observation_files import answers, changed, footage_of, seal

from ssp_core.cli import main
from ssp_core.files.reading import parse_value
from ssp_core.files.writing import write_json, write_text
from ssp_core.vocabulary import MOTIONS, OBJECTS
from ssp_eval.observations.files import Footage, load_observations
from ssp_eval.observations.model import REASONS, Answers, LaneWord, PlaceWord, RelationWord, leaves
from ssp_eval.observations.page import select_frames
from ssp_eval.observations.questions import Card, blank, cards
from ssp_scenario_manager.event_spec.log import read_log
from ssp_scenario_manager.event_spec.model import SegmentWord
from tests.support.processes.waiting import until
from tests.system.browser import Browser

Bags = Callable[..., Path]


@pytest.fixture
def run(make_bag: Bags) -> Path:
    """A run folder with a bag of 9 s at 10 Hz."""
    return make_bag("run/bag").parent


def questions(has_log: bool = False) -> list[Card]:
    return cards("vut", ("ot1", "ot2"), has_log)


def test_every_answer_of_the_file_is_asked_for_in_the_words_of_the_file() -> None:
    asked = {ask.path: ask for card in questions() for ask in card.asks}
    empty = blank("vut", ("ot1", "ot2"), False)
    wanted = {
        path for path, _ in leaves(empty) if path.rsplit(".")[-1] not in ("frames", "note", "role")
    }
    assert set(asked) == wanted
    words = {path: tuple(word for word, _ in ask.words) for path, ask in asked.items()}
    assert words["topology.segment"] == get_args(SegmentWord)
    assert words["topology.vut_lane"] == get_args(LaneWord)
    assert words["roles.participants.ot1.class"] == OBJECTS
    assert words["roles.participants.ot2.starts_in"] == get_args(PlaceWord)
    assert words["dominant_motion.value"] == MOTIONS
    assert words["conflict_type.value"] == get_args(RelationWord)
    assert {path for path in asked if path.startswith("source_gate.")} == {
        f"source_gate.{reason}.value" for reason in REASONS
    }
    assert Answers.model_validate(empty).unanswered()
    assert "log" not in blank("vut", ("ot1",), True)
    assert not any(ask.path.startswith("log.") for card in questions(True) for ask in card.asks)


@pytest.mark.parametrize(
    ("count", "period_s", "span", "found"),
    [
        (108, 1 / 12, (10.0,), list(range(108))),
        (90, 1 / 30, (10.0,), list(range(0, 90, 3))),
        (1800, 0.1, (10.0,), list(range(0, 1800, 3))),
        (90, 0.1, (5.0, 2.0, 3.01), [20, 22, 24, 26, 28, 30]),
        (1, 0.1, (10.0,), [0]),
    ],
)
def test_enough_frames_are_shown_and_not_too_many(
    count: int, period_s: float, span: tuple[float, ...], found: list[int]
) -> None:
    footage = Footage("", tuple(k * period_s for k in range(count)))
    assert select_frames(footage, *span) == found


def test_frames_before_the_start_are_not_shown() -> None:
    footage = Footage("", tuple(0.1 * k - 0.5 for k in range(20)))
    assert select_frames(footage, 10.0)[0] == 5


def test_a_template_says_no_answer_and_is_filled_in_with_an_editor(
    run: Path, tmp_path: Path
) -> None:
    out = tmp_path / "seen.yaml"
    assert main(["audit", "observe", str(run), "--template", "--out", str(out)]) == 0
    text = out.read_text()
    value = parse_value(text, out)
    assert value["bag_sha256"] == footage_of(run / "bag").bag_sha256
    assert all(
        item is None or item == [] or path.endswith(("role", "schema"))
        for path, item in leaves(value)
        if path not in ("recording", "bag_sha256", "scenario", "event_version")
    )
    for wanted in ("# straight | curve | junction", '"2_lanes_left"', "cutting_in_from_left"):
        assert wanted in text
    text = text.replace("who: null", "who: Ada Vance").replace("segment: null", "segment: straight")
    write_text(out, text)
    assert main(["audit", "observe", str(run), "--seal", str(out)]) == 1
    write_text(out, text.replace("    frames: []\n", "", 0).replace("frames: []", "frames: [5]", 1))
    assert main(["audit", "observe", str(run), "--seal", str(out)]) == 0
    ((path, one),) = load_observations(run / "bag", footage_of(run / "bag"))
    assert path == run / "observation_ada_vance.json"
    assert one.topology.segment == "straight"
    assert len(one.unanswered()) > 15


def test_sealing_binds_checks_and_enters_into_the_log(
    run: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    draft = tmp_path / "draft.json"
    write_json(draft, changed("source_gate.road.value", True, changed("roles.initiator", None)))
    arguments = ["audit", "observe", str(run), "--seal", str(draft)]
    assert main(arguments) == 0
    told = capfd.readouterr()
    assert "observed by Ada Vance, sha256:" in told.out
    assert "1 unverified: roles.initiator" in told.err
    assert "the source gate refuses it: road" in told.err
    sealed = json.loads((run / "observation_ada_vance.json").read_text())
    (entry,) = read_log(run / "bag.log.jsonl")
    assert (entry.kind, entry.who, entry.version) == (
        "observation",
        "Ada Vance",
        sealed["bag_sha256"],
    )
    assert entry.details["seal"] == sealed["seal"]
    assert main(arguments) == 1
    assert "exists already" in capfd.readouterr().err
    assert len(read_log(run / "bag.log.jsonl")) == 1


@pytest.mark.parametrize(
    ("given", "status", "problem"),
    [
        (["--who", "Ada"], 2, "--who and --log belong to --seal"),
        (["--template", "--seal", "x.json"], 2, "--seal takes neither"),
        (["--seal", "nowhere.json"], 1, "can't be read"),
        (["--from", "50"], 1, "has no frame from 50 to inf s"),
        (["--event", "no_such_event"], 1, "no_such_event"),
        (["--rate", "0"], 2, "is no number above 0"),
    ],
)
def test_wrong_use_is_said_and_nothing_is_written(
    given: list[str], status: int, problem: str, run: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    before = sorted(run.rglob("*"))
    assert main(["audit", "observe", str(run), *given]) == status
    assert problem in capfd.readouterr().err
    assert sorted(run.rglob("*")) == before


def test_a_recording_without_frames_cannot_be_observed(
    make_bag: Bags, capfd: pytest.CaptureFixture[str]
) -> None:
    bag = make_bag("blind", frames=False)
    assert main(["audit", "observe", str(bag)]) == 1
    assert "has no camera frames to look at" in capfd.readouterr().err


def test_two_observers_are_compared(
    run: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    bag = run / "bag"
    ada = seal(bag, tmp_path / "ada.json", answers())
    bo = seal(bag, tmp_path / "bo.json", changed("who", "Bo Ek"))
    cy = seal(bag, tmp_path / "cy.json", changed("who", "Cy", changed("topology.segment", "curve")))
    assert main(["audit", "agree", str(ada), str(bo)]) == 0
    assert "differ in nothing" in capfd.readouterr().err
    assert main(["audit", "agree", str(ada), str(cy)]) == 1
    told = capfd.readouterr()
    assert re.search(r"topology.segment +straight +curve +differ +unverified", told.out)
    assert "Ada Vance and Cy differ in 1: topology.segment" in told.err
    assert main(["audit", "agree", str(ada), str(cy), "--json"]) == 1
    value = json.loads(capfd.readouterr().out)
    assert value["observers"] == ["Ada Vance", "Cy"]
    assert main(["audit", "agree", str(ada)]) == 2
    assert main(["audit", "agree", str(ada), str(ada)]) == 1
    assert "looked twice" in capfd.readouterr().err


def test_help_shows_the_audit_and_what_else_there_is(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["audit", "--help"]) == 0
    told = capfd.readouterr().out
    assert "SYN SIM PHY" in told
    assert "ssp audit observe" in told
    assert main(["audit", "observe", "--help"]) == 0
    assert "Usage: ssp audit observe [OPTIONS] BAG" in capfd.readouterr().out


# -- the page ------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with Browser((1400, 900)) as found:
        yield found


def page_of(run: Path, *options: str) -> Path:
    out = run / "page.html"
    assert main(["audit", "observe", str(run), "--out", str(out), "--force", *options]) == 0
    return out


def test_the_page_stands_alone_and_says_no_answer(run: Path) -> None:
    text = page_of(run, "--event", "cut_in").read_text()
    assert not re.search(r"https?://", text)
    assert "@import" not in text
    data = json.loads(text.split('type="application/json">')[1].split("</script>")[0])
    assert len(data["frames"]) == 90
    assert all(frame["src"].startswith("data:image/jpeg;base64,") for frame in data["frames"])
    assert data["draft"]["scenario"] == "cut_in"
    empty = blank("vut", ("ot1",), True)
    assert {key: data["draft"][key] for key in empty} == empty
    assert data["draft"]["who"] is None


def test_a_recording_name_cannot_break_out_of_the_page(make_bag: Bags) -> None:
    bag = make_bag("</script><b>x")
    out = bag.parent / "page.html"
    assert main(["audit", "observe", str(bag), "--out", str(out)]) == 0
    text = out.read_text()
    assert "<b>x" not in text
    assert text.count("</script>") == 2


def press(browser: Browser, ask: str, number: int) -> None:
    """Presses the n-th choice of a question, from 1."""
    browser.click(f'[data-ask="{ask}"] .chips button:nth-of-type({number})')


def choose(browser: Browser, ask: str, text: str) -> None:
    """Presses the choice that reads so."""
    found = browser.evaluate(
        f"""[...document.querySelectorAll('[data-ask="{ask}"] .chips button')]
        .findIndex((b) => b.innerText === {json.dumps(text)})"""
    )
    assert found >= 0, (ask, text)
    press(browser, ask, found + 1)


def key(browser: Browser, letter: str) -> None:
    browser.press(letter, f"Key{letter.upper()}", ord(letter.upper()), letter)


def name(browser: Browser, who: str) -> None:
    browser.click("#who")
    browser.ask("Input.insertText", text=who)
    browser.evaluate("document.activeElement.blur()")


def frame_number(browser: Browser) -> int:
    return int(browser.evaluate("FRAMES[now].n"))


def go(browser: Browser, frame: int) -> None:
    browser.evaluate(f"show(nearest({frame}))")


def test_a_person_fills_in_the_page_saves_and_seals_it(
    run: Path, browser: Browser, tmp_path: Path
) -> None:
    downloads = tmp_path / "downloads"
    browser.ask("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(downloads))
    browser.go(page_of(run).as_uri())
    first = frame_number(browser)
    assert first == 5  # those before the session's start aren't shown
    browser.press("ArrowRight", "ArrowRight", 39)
    assert frame_number(browser) == first + 1
    browser.press("ArrowLeft", "ArrowLeft", 37)

    browser.click("#save")
    assert "whose is it" in browser.text("#saved")
    name(browser, "Ada Vance")
    browser.click("#save")
    assert "questions are open" in browser.text("#saved")
    assert not downloads.exists()

    choose(browser, "topology.segment", "straight")
    choose(browser, "topology.lanes_same_direction", "1")
    choose(browser, "topology.lanes_opposite", "can't tell")
    choose(browser, "topology.road_type", "urban")
    choose(browser, "topology.left_boundary", "can't tell")
    choose(browser, "topology.right_boundary", "kerb")
    assert "there is only one" in browser.text('[data-ask="topology.vut_lane"]')
    browser.click("#save")
    assert "lack frames that show them" in browser.text("#saved")
    browser.click("#stage")
    browser.wait("state.doc.topology.frames.length === 1")
    choose(browser, "roles.participants.vut.class", "car")
    choose(browser, "roles.participants.ot1.class", "car")
    choose(browser, "roles.participants.ot1.starts_in", "one lane to the right")
    choose(browser, "roles.initiator", "ot1")
    choose(browser, "roles.affected", "vut")
    key(browser, "e")
    choose(browser, "dominant_motion.value", "cutting in from right")
    go(browser, 45)
    key(browser, "s")
    go(browser, 60)
    key(browser, "s")
    choose(browser, "conflict_type.value", "merge: it comes into the lane of the other")
    key(browser, "e")
    choose(browser, "passing_order.value", "ot1 before vut")
    key(browser, "e")
    for letter, frame in (("t", 46), ("c", 50), ("r", 40)):
        go(browser, frame)
        key(browser, letter)
    browser.click("#save")
    assert "out of order" in browser.text("#saved")
    go(browser, 80)
    key(browser, "r")
    choose(browser, "identity_stable.value", "yes")
    for reason in REASONS:
        choose(browser, f"source_gate.{reason}.value", "no")
    choose(browser, "visibility.participants.ot1.value", "throughout")
    assert "1 open" in browser.text("#missing")
    choose(browser, "visibility.conflict_region.value", "can't tell")
    assert browser.text("#missing") == "all answered"
    browser.click("#save")
    browser.wait("!document.querySelector('#saved').classList.contains('warn')")
    assert f"ssp audit observe {run} --seal draft_run_Ada_Vance.json" in browser.text("#saved")
    draft = wait_for(downloads / "draft_run_Ada_Vance.json")
    assert [
        r for r in browser.requests if not r.startswith(("data:", "blob:", "file:", "about:"))
    ] == []
    assert browser.console == []

    assert main(["audit", "observe", str(run), "--seal", str(draft)]) == 0
    ((_, one),) = load_observations(run / "bag", footage_of(run / "bag"))
    assert one.who == "Ada Vance"
    assert one.unanswered() == ("topology.lanes_opposite", "visibility.conflict_region.value")
    assert one.phase_starts() == {"trigger": 4.1, "conflict": 4.5, "resolution": 7.5}
    assert one.phases.trigger.frames == [46]
    assert one.dominant_motion.frames == [(45, 60)]
    assert one.source_gate.road.frames == [(5, 94)]
    assert one.passing_order.value == ("ot1", "vut")


def wait_for(path: Path) -> Path:
    """A download, once it is whole."""
    until(
        lambda: path.is_file() and path.read_text().endswith("}\n"),
        lambda: f"{path.name} in {sorted(path.parent.iterdir())}",
    )
    return path


def test_answers_survive_the_page_and_a_draft_goes_on(run: Path, browser: Browser) -> None:
    page = page_of(run)
    browser.go(page.as_uri())
    name(browser, "Bo Ek")
    choose(browser, "topology.segment", "curve")
    choose(browser, "conflict_type.value", "can't tell")
    browser.evaluate("setChanged(false)")
    browser.go(page.as_uri())
    # Another person may sit here now.
    assert browser.evaluate("get('topology.segment')") is None
    assert "Unsaved answers of Bo Ek" in browser.text("#saved")
    browser.click("#go-on")
    assert browser.evaluate("get('topology.segment')") == "curve"
    assert browser.evaluate("state.cannot['conflict_type.value']") is True
    assert browser.evaluate("$('who').value") == "Bo Ek"
    draft: dict[str, Any] = browser.evaluate("result()")
    draft["topology"]["segment"] = "straight"
    browser.evaluate(f"load({json.dumps(json.dumps(draft))})")
    assert browser.evaluate("get('topology.segment')") == "straight"
    draft["bag_sha256"] = "sha256:" + "0" * 64
    browser.evaluate(f"load({json.dumps(json.dumps(draft))})")
    assert browser.text("#told") == "That observation is of another recording."
    browser.evaluate("load('no json')")
    assert browser.text("#told").startswith("That file is no JSON")
    browser.evaluate("load('null')")
    assert browser.text("#told") == "That file is no observation."
    browser.evaluate("setChanged(false)")
    browser.go(page.as_uri())
    browser.click("#drop")
    browser.go(page.as_uri())
    assert browser.evaluate("$('saved').hidden") is True


def test_zooming_and_moving_mark_nothing_and_a_double_click_shows_the_whole(
    run: Path, browser: Browser
) -> None:
    browser.go(page_of(run).as_uri())
    browser.evaluate("setZoom(4)")
    assert "scale(4)" in browser.evaluate("$('picture').style.transform")
    box = browser.evaluate(
        "(() => { const b = $('stage').getBoundingClientRect(); return [b.x, b.y]; })()"
    )
    for kind, dx in (("mousePressed", 200), ("mouseMoved", 120), ("mouseReleased", 120)):
        browser.ask(
            "Input.dispatchMouseEvent",
            type=kind,
            x=box[0] + dx,
            y=box[1] + 100,
            button="left",
            buttons=1,
            clickCount=1,
        )
    browser.click("#stage")
    browser.click("#stage")
    assert browser.evaluate("$('picture').style.transform") == ""
    assert browser.evaluate("state.doc.topology.frames.length") == 0
