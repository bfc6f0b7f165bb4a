"""A file changed since its evaluation is refused by name, and the report goes on."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
from evaluation_files import audit_file, resealed

from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_core.files.writing import write_json
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.clients.model_client import InProcessClients
from ssp_eval.evaluate.clients.models import bridge_spec
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.store.admission import audit_files, load_admissions
from ssp_eval.evaluate.store.results import load_cells
from ssp_eval.report.page import write_report
from ssp_eval.score.thresholds import DEFAULT, thresholds_of

Value = dict[str, Any]
MODELS = ("constant_velocity", "opencv_baseline")
CELL = f"cut_in__simulation__{MODELS[0]}"
OTHER = f"cut_in__simulation__{MODELS[1]}"


def evaluated(bag: Path, out: Path, audit: Path) -> None:
    run_campaign(
        [(bag, None)],
        [bridge_spec(name) for name in MODELS],
        InProcessClients(),
        out,
        CellOptions(),
        True,
        load_admissions([audit]),
    )


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, bag_writer: Callable[..., Path]) -> Path:
    """A bag, its audit, and a campaign of two models in which it is admitted."""
    root = tmp_path_factory.mktemp("changed")
    bag = bag_writer(root / "bag")
    evaluated(bag, root / "out", audit_file(root / "audit.json", "admitted", bag))
    return root


@pytest.fixture
def campaign(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made / "out", tmp_path / "out"))


def edit(file: Path, change: Callable[[Value], object]) -> None:
    value = json.loads(file.read_text())
    change(value)
    write_json(file, value)


def replaced(file: Path, old: str, new: str) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


Change = Callable[[Path], object]
CHANGES: list[tuple[str, Change, str]] = [
    (
        "records",
        lambda c: replaced(c / "records.jsonl", "maintain", "decelerate"),
        "records.jsonl was changed since the cell was evaluated",
    ),
    (
        "score",
        lambda c: edit(c / "score.json", lambda v: v.update(ivcs=1.0)),
        "score.json was changed since",
    ),
    (
        "raw",
        lambda c: replaced(c / "raw.jsonl", "latency_s", "latency_s "),
        "raw.jsonl was changed since",
    ),
    ("requests", lambda c: (c / "requests.jsonl").unlink(), "requests.jsonl came or went since"),
    (
        "labels",
        lambda c: replaced(c / "labels.json", "cutting_in", "crossing"),
        "labels.json was changed since",
    ),
    (
        "status",
        lambda c: edit(c / "cell.json", lambda v: v.update(stand_in=True)),
        "cell.json was changed since it was written",
    ),
    (
        "unsealed",
        lambda c: edit(c / "cell.json", lambda v: v["hashes"].pop("cell")),
        "cell.json names no hash of itself",
    ),
    (
        "hash",
        lambda c: edit(c / "cell.json", lambda v: v["hashes"].update(score="sha256:0")),
        "cell.json was changed since it was written",
    ),
    (
        "copied",
        lambda c: replaced(c / "cell.json", MODELS[0], "mine") or resealed(c),
        "it is the cell cut_in__simulation__mine, and lies in another one's folder",
    ),
    (
        "no audit",
        lambda c: resealed(c, lambda v: v["admission"].update(audit_sha256=None)),
        "it says admitted and names no audit",
    ),
    ("audit gone", lambda c: shutil.rmtree(c.parents[1] / "audits"), "isn't in audits/"),
    (
        "other bag",
        lambda c: resealed(c, lambda v: v["hashes"].update(bag="sha256:0")),
        "it is not known of",
    ),
    (
        "refused",
        lambda c: resealed(c, lambda v: v["admission"].update(status="refused")),
        "it is scored though the audit refused its recording",
    ),
    (
        "unpaired",
        lambda c: resealed(c, lambda v: v["admission"].update(status="unpaired")),
        "it says unpaired of event version",
    ),
    (
        "version",
        lambda c: resealed(c, lambda v: v.update(event_version="sha256:0")),
        "it says admitted of event version sha256:0, and by",
    ),
]


@pytest.mark.parametrize(("change", "why"), [c[1:] for c in CHANGES], ids=[c[0] for c in CHANGES])
def test_a_cell_that_was_changed_is_refused_by_name(
    change: Change, why: str, campaign: Path
) -> None:
    change(campaign / "cells" / CELL)
    cells = {cell.id: cell for cell in load_cells(campaign)}
    assert (cells[CELL].score, cells[CELL].facts.status) == (None, "refused")
    assert why in cells[CELL].changed
    assert cells[CELL].facts.reasons == [cells[CELL].changed]
    assert (cells[OTHER].score is None) == ("audits" in why)


@pytest.mark.parametrize("text", ["{}", "", "[]", '{"schema": "ssp.cell/1"', "{}\xff"])
def test_a_cell_that_cannot_be_read_is_listed_and_the_report_is_made(
    text: str, campaign: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (campaign / "cells" / CELL / "cell.json").write_bytes(text.encode("latin-1"))
    other = campaign / "cells" / "a_folder_of_somebody"
    other.mkdir()
    (other / "cell.json").write_text("{}")
    assert main(["report", str(campaign)]) == 1
    told = capfd.readouterr().err
    assert f"{campaign / 'cells' / CELL}: refused: cell.json can't be read" in told
    assert f"{other}: refused: cell.json can't be read" in told
    page = (campaign / "index.html").read_text()
    assert "cell.json can" in page
    cells = {cell.id: cell for cell in load_cells(campaign)}
    assert cells[OTHER].score is not None
    facts = cells[CELL].facts
    assert f"{facts.scenario}__{facts.domain}__{facts.model}" == CELL


def replaced_number(text: str, key: str, new: str) -> str:
    found = re.sub(rf'("{key}": )[^,\n]+', rf"\g<1>{new}", text)
    assert found != text
    return found


NOT_WHOLE = "is not valid JSON: Unterminated string"
SCORES = [
    ("NaN", lambda t: replaced_number(t, "ivcs", "NaN"), "NaN is no number"),
    ("infinity", lambda t: replaced_number(t, "rl_s", "Infinity"), "Infinity is no number"),
    ("huge", lambda t: replaced_number(t, "ivcs", "1e300"), r"ivcs: must be .* \(got 1e\+300\); "),
    ("share", lambda t: replaced_number(t, "tqsr", "1.5"), r"tqsr: .*equal to 1 \(got 1.5\); "),
    ("late", lambda t: replaced_number(t, "rl_s", "1e9"), r"rl_s: must be .* 86400 s, .*\(got "),
    ("negative", lambda t: replaced_number(t, "n", "-1"), r"n: .*equal to 0 \(got -1\); "),
    ("text", lambda t: replaced_number(t, "jovr", '"1"'), r"jovr: .*number \(got '1'\); "),
    ("boolean", lambda t: replaced_number(t, "rsr", "true"), r"rsr: .*integer \(got True\); "),
    ("missing", lambda t: re.sub(r'"stfr": [^,]+,', "", t), "stfr: Field required; add it"),
    ("twice", lambda t: t.replace('"stfr"', '"cia_eff"', 1), "key 'cia_eff' stands twice"),
    ("unknown", lambda t: t.replace("{", '{"ivs": 1,', 1), "ivs: .*did you mean ivcs"),
    ("inner", lambda t: t.replace('"cia": ', '"cai": 1, "cia": '), "denominators.cai: .*mean cia"),
    ("schema", lambda t: t.replace("{", '{"schema": "ssp.score/2",', 1), "schema: .*known: n, "),
    ("cut", lambda t: t[: t.index("denominators")], NOT_WHOLE),
    ("list", lambda t: f"[{t}]", "must hold a mapping at its top"),
    ("none", lambda t: "null", "must hold a mapping at its top"),
]


@pytest.mark.parametrize(("spoil", "why"), [c[1:] for c in SCORES], ids=[c[0] for c in SCORES])
def test_a_score_of_another_form_is_one_line_with_a_remedy(
    spoil: Callable[[str], str], why: str, campaign: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The cell that names it is sealed as an evaluation would seal it."""
    folder = campaign / "cells" / CELL
    file = folder / "score.json"
    file.write_text(spoil(file.read_text()))
    resealed(folder)
    assert main(["report", str(campaign)]) == 1
    (line,) = (one for one in capfd.readouterr().err.splitlines() if CELL in one)
    begins = f"error: {folder}: refused: score.json can't be read: {file}: "
    assert line.startswith(begins)
    assert re.search(why, line), line
    assert "; " in line
    assert "score.json can" in (campaign / "index.html").read_text()


def test_a_report_goes_on_without_it_and_says_so_in_page_tables_and_exit_status(
    campaign: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    arguments = ["report", str(campaign), "--tables", str(campaign / "tables"), "--format", "csv"]
    assert main([*arguments, "--resamples", "100"]) == 0
    edit(campaign / "cells" / CELL / "score.json", lambda v: v.update(ivcs=1.0))
    capfd.readouterr()
    assert main([*arguments, "--resamples", "100"]) == 1
    why = "score.json was changed since the cell was evaluated"
    assert f"{campaign / 'cells' / CELL}: refused: {why}" in capfd.readouterr().err
    page = (campaign / "index.html").read_text()
    assert why in page
    for table in (campaign / "tables").glob("by_*.csv"):
        assert MODELS[0] not in table.read_text()
    # So does the page of a large campaign.
    assert why in write_report(campaign, most=0).read_text()
    assert main(["shortlist", str(campaign), str(campaign)]) == 1
    assert why in capfd.readouterr().err


def test_a_picture_that_is_another_one_is_not_shown(campaign: Path) -> None:
    before = write_report(campaign).read_text().count("data:image/jpeg")
    frames = sorted((campaign / "frames").iterdir())
    frames[0].write_bytes(frames[1].read_bytes())
    assert write_report(campaign).read_text().count("data:image/jpeg") == before - 1


@pytest.mark.parametrize("name", ["raw.jsonl", "earlier.jsonl"])
def test_changed_answers_are_not_gone_on_with(name: str, made: Path, campaign: Path) -> None:
    bag, audit = made / "bag", made / "audit.json"
    if name == "earlier.jsonl":
        # Answers to a label that is asked no more.
        file = made / "bag.labels.json"
        before = file.read_text()
        edit(file, lambda v: v["labels"].pop(0))
        evaluated(bag, campaign, audit)
        file.write_text(before)
    file = campaign / "cells" / CELL / name
    replaced(file, "constant_velocity", "constant_velocitx")
    with pytest.raises(InputError, match="was changed since the cell was evaluated") as caught:
        evaluated(bag, campaign, audit)
    assert caught.value.file == str(file)
    shutil.rmtree(file.parent)
    evaluated(bag, campaign, audit)
    assert [cell.changed for cell in load_cells(campaign)] == ["", ""]


def test_an_interrupted_run_leaves_no_cell_json_and_is_gone_on_with(
    made: Path, campaign: Path
) -> None:
    """Else it would name another raw.jsonl than the one that is half written."""

    class Interrupted(InProcessClients):
        def client(self, *given: Any) -> Any:
            found = super().client(*given)
            answers = iter(range(3))

            class Asking:
                ignored = found.ignored

                def ask(self, request: Any) -> Any:
                    if next(answers, None) is None:
                        raise KeyboardInterrupt
                    return found.ask(request)

            return Asking()

    bag, models = made / "bag", [bridge_spec(MODELS[0])]
    fresh = CellOptions(fresh=True)
    with pytest.raises(KeyboardInterrupt):
        run_campaign([(bag, None)], models, Interrupted(), campaign, fresh, True)
    assert not (campaign / "cells" / CELL / "cell.json").exists()
    evaluated(bag, campaign, made / "audit.json")
    assert [cell.changed for cell in load_cells(campaign)] == ["", ""]


def test_the_audit_that_cells_go_by_is_kept_once(made: Path) -> None:
    evaluated(made / "bag", made / "out", made / "audit.json")
    (kept,) = audit_files(made / "out").values()
    assert kept.read_bytes() == (made / "audit.json").read_bytes()


def test_a_folder_in_place_of_a_cells_file_is_named(made: Path, campaign: Path) -> None:
    file = campaign / "cells" / CELL / "cell.json"
    file.unlink()
    file.mkdir()
    with pytest.raises(InputError, match="is a folder") as caught:
        evaluated(made / "bag", campaign, made / "audit.json")
    assert caught.value.file == str(file)
    assert caught.value.remedy


@pytest.mark.parametrize("number", [1e308, 10**400, 2.5, 10**9])
def test_thresholds_that_no_scorer_can_use_are_refused(number: float) -> None:
    values = {**asdict(DEFAULT), "response_count": number}
    with pytest.raises(
        InputError, match=r"thresholds\.response_count: is no such number"
    ) as caught:
        thresholds_of(values, "cell.json")
    assert caught.value.remedy
    assert thresholds_of(asdict(DEFAULT), "cell.json") == DEFAULT
