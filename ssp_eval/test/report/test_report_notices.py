"""The warnings of the page: cells and ranks that can't be compared."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from evaluation_files import resealed

from ssp_core.bag.reading.reader import BagReader
from ssp_core.run_file.participation import CAMERA, Participation
from ssp_eval.data.provenance import OUR_RENDERER, ImportRecord, read_provenance
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.clients.model_client import InProcessClients
from ssp_eval.evaluate.clients.models import bridge_spec
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.run import show
from ssp_eval.evaluate.store.admission import ADMITTED
from ssp_eval.evaluate.store.results import AdmissionFacts, CellData, load_cells
from ssp_eval.extract.combined.extractor import Extractor, TextExtraction
from ssp_eval.report import making
from ssp_eval.report.page import write_report
from ssp_eval.score.thresholds import Thresholds
from ssp_eval.statistics.constants import constant_rows
from ssp_eval.statistics.csv_rows import rows_from_csv
from ssp_eval.statistics.rows import OTHER_LABELS, CellRow, entering, rows_from_campaign
from ssp_eval.statistics.table import write_tables
from ssp_eval.statistics.tables.notices import Notice, domain_text, everywhere, lead, notices
from ssp_eval.statistics.tables.scores import all_tables, matrix_table
from tests.support.score_rows import row

BagMaker = Callable[..., Path]
MODELS = ("constant_velocity", "opencv_baseline")


def evaluated(out: Path, bags: list[Path], *names: str, extractor: Extractor | None = None) -> None:
    options = CellOptions() if extractor is None else CellOptions(extractor=extractor)
    models = [bridge_spec(name) for name in names]
    run_campaign([(bag, None) for bag in bags], models, InProcessClients(), out, options, True)


@pytest.fixture(scope="module")
def bags(bag_writer: BagMaker, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("bags")
    return [bag_writer(folder / "bag"), bag_writer(folder / "track", domain="physical")]


@pytest.fixture(scope="module")
def done(bags: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("evaluated") / "out"
    evaluated(out, bags, *MODELS)
    return out


@pytest.fixture
def campaign(done: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(done, tmp_path / "out"))


def test_others_are_asked_about_a_driven_recording_and_the_page_says_who_drove(
    make_bag: BagMaker, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    models = [bridge_spec("constant_velocity")]
    bags = [(make_bag(driver="other_model"), None)]
    (result,) = run_campaign(bags, models, InProcessClients(), out, CellOptions(), True)
    assert (result.status, result.admission, result.driven_by) == ("ok", "unaudited", "other_model")
    show([result], out)
    assert "unaudited, driven by other_model" in capsys.readouterr().out
    (row,) = rows_from_campaign(out)
    assert (row.admitted, row.reason) == (False, "driven by other_model")
    page = write_report(out).read_text()
    assert "cut_in / simulation: other_model drove the VUT." in page


def test_a_whole_campaign_needs_none_of_it(campaign: Path) -> None:
    page = write_report(campaign).read_text()
    for words in ("Not comparable", "on the same cells", "lack what the LLM"):
        assert words not in page


def test_cells_of_different_recordings_are_named(campaign: Path) -> None:
    other = {"bag": "sha256:" + "9" * 64}
    folder = campaign / "cells" / "cut_in__physical__opencv_baseline"
    resealed(folder, lambda facts: facts["hashes"].update(other))
    page = write_report(campaign).read_text()
    assert "Not comparable: the cells of cut_in / physical use different recordings" in page


def runs(
    monkeypatch: pytest.MonkeyPatch, **cells_by_run: list[CellData]
) -> tuple[list[CellRow], list[Notice]]:
    """Rows and notices of campaigns whose cells are these, audited and admitted."""
    audited = {"admission": AdmissionFacts(status=ADMITTED)}
    admitted = {
        name: [replace(cell, facts=cell.facts.model_copy(update=audited)) for cell in cells]
        for name, cells in cells_by_run.items()
    }
    monkeypatch.setattr(making, "cell_files", lambda _: [])
    monkeypatch.setattr(making, "load_cells", lambda folder, _: admitted[folder.name])
    data, rows, constants = making.runs_of(Path(name) for name in admitted)
    assert [row.admitted for row in constant_rows(constants)] == [
        row.admitted for row in rows if row.model == MODELS[0]
    ]
    return rows, notices(rows, data)


def test_domains_of_several_runs_are_compared_by_their_labels(
    campaign: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cells = load_cells(campaign)
    simulation = [cell for cell in cells if cell.domain == "simulation"]
    physical = [cell for cell in cells if cell.domain == "physical"]
    fewer = [
        replace(cell, labels=replace(cell.labels, labels=cell.labels.labels[:-1]))
        for cell in physical
    ]
    for by_run in (
        {"a": [*simulation, *fewer], "b": simulation},
        {"a": simulation, "b": fewer},
        {"a": [*simulation, *physical], "b": fewer},
    ):
        rows, told = runs(monkeypatch, **by_run)
        assert not any(row.admitted for row in rows)
        assert {row.reason for row in rows} == {OTHER_LABELS}
        (one,) = [x for x in told if "labels of cut_in lie at different places" in x.text]
        assert (one.kind, one.everywhere, one.about) == ("comparability", True, ("cut_in",))
    # Each has a partner in the other domain.
    for by_run in (
        {"a": simulation, "b": physical},
        {"a": [*simulation, *physical], "b": simulation},
    ):
        rows, told = runs(monkeypatch, **by_run)
        assert all(row.admitted and not row.reason for row in rows)
        assert not any("Not comparable" in x.text for x in told)


def test_a_repetition_of_another_version_of_the_event_is_told(
    campaign: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cells = load_cells(campaign)
    other = {"event_version": "sha256:" + "9" * 64}
    later = [replace(one, facts=one.facts.model_copy(update=other)) for one in cells]
    _, told = runs(monkeypatch, a=cells, b=later)
    text = "Not comparable: the cells of cut_in use different versions of K*."
    assert [x.everywhere for x in told if x.text == text] == [True]


@pytest.mark.parametrize("most", [None, 0])
def test_a_scenario_without_any_cell_is_named(campaign: Path, most: int | None) -> None:
    """That of one and of many cells; without it nothing in the folder says that it is absent."""
    told = "Missing: no model was asked about vru_crossing, which this campaign was planned with"
    expected = ("cut_in", "vru_crossing")
    assert told in write_report(campaign, most=most, expected=expected).read_text()
    assert "Missing: no model" not in write_report(campaign, expected=expected[:1]).read_text()


def test_ranks_over_different_cells_say_who_lacks_some(campaign: Path, bags: list[Path]) -> None:
    evaluated(campaign, bags[:1], 'one={"backend": "constant_velocity"}')
    page = write_report(campaign).read_text()
    assert "The models were not scored on the same cells (of 2: one 1)" in page


def test_a_gap_is_named_and_a_recording_without_twins_is_none() -> None:
    rows = [
        row(domain="simulation"),
        row(domain="simulation", model="m+twin.without.ot1"),
        row(domain="simulation", model="other"),
        row(domain="physical"),
    ]
    (told,) = [one.text for one in notices(rows) if one.text.startswith("Not evaluated")]
    assert told == (
        "Not evaluated: 1 cell is missing; these models weren't asked about these recordings: "
        "s / physical / other."
    )


class Troubled(Extractor):
    """An extractor whose LLM can't be reached."""

    def __call__(self, text: str) -> TextExtraction:
        return replace(super().__call__(text), trouble="no answer: it is away")

    @property
    def sha256(self) -> str:
        return "sha256:" + "7" * 64


class German(Extractor):
    """An extractor that reads a fixed German answer in place of any text."""

    def __call__(self, text: str) -> TextExtraction:
        return super().__call__("Vor uns bremst ein Lastwagen, wir halten die Spur.")


def test_texts_in_another_language_are_said(bags: list[Path], tmp_path: Path) -> None:
    evaluated(tmp_path / "out", bags[:1], MODELS[0], extractor=German())
    page = " ".join(write_report(tmp_path / "out").read_text().replace("&#39;", "'").split())
    told = "in a language that the rules don't read"
    assert f"9 of 9 texts are {told} (de 9)" in page
    assert f"Texts {told} (they read English): {MODELS[0]}." in page


def test_two_extractors_and_an_llm_that_is_away_are_said(campaign: Path, bags: list[Path]) -> None:
    evaluated(campaign, bags[1:], MODELS[0], extractor=Troubled())
    page = " ".join(write_report(campaign).read_text().split())
    assert "were read by 2 different extractors" in page
    assert "9 of 9 records lack what the LLM of the extraction would have filled" in page


def test_cells_of_other_thresholds_are_scored_by_these_and_enter_no_mean(
    campaign: Path, bags: list[Path], tmp_path: Path
) -> None:
    """A wider window of matching changes nothing here but the hash."""
    wide = Thresholds(match_window_s=0.2)
    models = [bridge_spec(MODELS[0])]
    options = CellOptions(thresholds=wide)
    run_campaign([(bags[1], None)], models, InProcessClients(), campaign, options, True)
    cells = {(cell.domain, cell.model): cell for cell in load_cells(campaign)}
    apart = cells["physical", MODELS[0]]
    assert apart.thresholds == wide
    assert apart.score is not None
    assert apart.score.details.thresholds_sha256 == wide.sha256
    assert apart.notes == ()
    rows = rows_from_campaign(campaign)
    assert len(entering(rows)) == len(rows) - 1
    page = " ".join(write_report(campaign).read_text().replace("&#39;", "'").split())
    name = f"cut_in / physical / {MODELS[0]}"
    assert f"Scored with thresholds other than METHOD's: {name}." in page
    assert "1 cell scored with other thresholds left out." in page
    # The matrix holds it, and is read back as it is.
    path, _ = write_tables(tmp_path / "tables", [matrix_table(rows)], ["csv"])
    assert {row.key: row for row in rows_from_csv(path)} == {row.key: row for row in rows}
    # All cells alike: they enter, and everywhere it is said how they were scored.
    run_campaign([(bag, None) for bag in bags], models, InProcessClients(), tmp_path, options, True)
    again = rows_from_campaign(tmp_path)
    assert len(entering(again)) == len(again) == 2
    told = [one.text for one in notices(again) if one.everywhere]
    assert "Scored with thresholds other than METHOD's: all cells." in told


def test_domains_that_one_renderer_drew_are_told(campaign: Path) -> None:
    """Both recordings are sessions of ours, and the camera of these draws them."""
    told = "The camera of ssp drew the pictures of 2 domains: simulation, physical."
    assert told in " ".join(write_report(campaign).read_text().split())
    for folder in campaign.glob("cells/cut_in__physical__*"):
        # As of a camera on a vehicle.
        resealed(folder, lambda facts: facts["clip"].update(renderer=None))
        resealed(folder, lambda facts: facts["clip"].update(accepted=["cut_pictures"]))
    page = " ".join(write_report(campaign).read_text().split())
    assert "drew the pictures" not in page
    assert "Accepted unchanged at import: cut_pictures in cut_in / physical." in page


def test_who_drew_a_recording_is_known_of_ours_and_of_what_names_a_generator(
    bags: list[Path],
) -> None:
    with BagReader(bags[0]) as bag:
        ours = read_provenance(bag)
    assert ours.run is not None
    assert ours.renderer == OUR_RENDERER
    live = ours.run.model_copy(update={"mode": "live", "stand_in": False})
    real = Participation("live", {CAMERA: ("real",)})
    assert replace(ours, run=live, participation=real).renderer is None
    drawn = Participation("live", {CAMERA: ("simulated",)})
    assert replace(ours, run=live, participation=drawn).renderer == OUR_RENDERER
    for generator, renderer in (
        ("ssp-clip/1", OUR_RENDERER),
        ("esmini 3.2", "esmini 3.2"),
        ("unknown", None),
    ):
        said = ImportRecord.model_construct(generator=generator)
        assert replace(ours, run=None, imported=said).renderer == renderer


CAUSES = ("says something about", "because of", "due to", "owed to the domain", "realised in")


def test_nothing_above_the_matrix_says_what_a_difference_comes_from(campaign: Path) -> None:
    """One recording of each event and domain, drawn by one renderer, with a stand-in."""
    page = " ".join(write_report(campaign).read_text().replace("&#39;", "'").split())
    above = page[: page.index('<section id="matrix">')]
    assert not [words for words in CAUSES if words in above]
    assert "nothing here shows which of their properties causes it" in above
    assert "Differences between these domains say nothing about pictures from a camera" in above
    assert "Whether the recordings show the same event is judged" not in above  # nobody did
    (told,) = {
        note
        for table in all_tables(rows_from_campaign(campaign))
        for note in table.notes
        if table.name == "domain_differences" and "cause" in note
    }
    assert "nothing here shows which of their properties causes a difference" in told


def test_what_the_lead_says_follows_from_the_cells() -> None:
    one = lead([row(domain="simulation")])
    assert one.startswith("Scores of driving")
    assert "forward video of one event, recorded in the simulation domain." in one
    assert "difference" not in one
    more = lead([row(domain="physical"), row(domain="simulation", model="other")])
    assert "in the simulation and physical domains" in more
    assert "between two models holds for these recordings only" in more
    assert "between two domains is a difference between recordings" in more


def test_by_whose_word_a_recording_is_of_its_domain_is_told(campaign: Path) -> None:
    """The declaration stands on the page, under every table and in every caption."""
    word = "A. Engineer, 2026-03-01, north track"
    for folder in campaign.glob("cells/cut_in__physical__*"):
        resealed(folder, lambda facts: facts["clip"].update(declared_by=word))
    told = f"Physical as declared by {word}: cut_in / physical."
    rows = rows_from_campaign(campaign)
    assert told in domain_text(rows)
    assert told in " ".join(write_report(campaign).read_text().split())
    assert told in everywhere(notices(rows))


def test_cells_and_imports_of_before_an_update_are_told(campaign: Path) -> None:
    assert "rules of an earlier version" not in write_report(campaign).read_text()
    folder = campaign / "cells" / f"cut_in__physical__{MODELS[0]}"
    resealed(folder, lambda facts: facts.pop("rules_version"))
    page = " ".join(write_report(campaign).read_text().replace("&#39;", "'").split())
    told = (
        f"Scored by the rules of an earlier version: cut_in / physical / {MODELS[0]}. They aren't"
    )
    assert told in page
    assert "docs/updating.md" in page
    for cell in campaign.glob("cells/*"):
        resealed(cell, lambda facts: facts.update(rules_version=1))
        resealed(cell, lambda facts: facts["clip"].update(import_rules=1))
    page = " ".join(write_report(campaign).read_text().split())
    assert "Scored by the rules of an earlier version: all cells." in page
    assert "Imported by the rules of an earlier version: cut_in / physical, " in page
