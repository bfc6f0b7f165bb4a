"""Pages in a package are made again: an edited one is found, whatever digests were mended."""

from __future__ import annotations

import base64
import html
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from markupsafe import escape

from ssp_core.cli import main
from ssp_core.hashing import sha256_bytes
from ssp_eval.package.make import make_package
from ssp_eval.package.model import Package, load_table, object_path, sealed, table_bytes
from ssp_eval.package.pages import difference
from ssp_eval.package.verify import verify_package
from ssp_eval.report.making import Making

AUDIT_PAGE = "demo/audits/cut_in/audit.html"
REPORT = "demo/index.html"


@pytest.fixture(scope="module")
def paged(evidence: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A package of a campaign with its report."""
    root = tmp_path_factory.mktemp("paged")
    campaign = Path(shutil.copytree(evidence, root / "demo"))
    assert main(["report", str(campaign), "--resamples", "200", "--expect", "cut_in"]) == 0
    make_package([campaign], root / "package")
    return root / "package"


@pytest.fixture
def own_paged(paged: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(paged, tmp_path / "package"))


def edit(package: Path, path: str, change: Callable[[str], str]) -> None:
    """Changes a page and every digest of it, as a forger does who knows how a package is made."""
    table = load_table(package).model_dump(mode="json", by_alias=True)
    (entry,) = (e for e in table["files"] if e["path"] == path)
    before = object_path(package, entry["sha256"]).read_text()
    data = change(before).encode()
    assert data != before.encode()
    object_path(package, entry["sha256"]).unlink()
    entry["sha256"], entry["bytes"] = sha256_bytes(data), len(data)
    object_path(package, entry["sha256"]).write_bytes(data)
    (package / "package.json").write_bytes(table_bytes(sealed(Package.model_validate(table))))


def texts_in(package: Path, path: str) -> list[str]:
    findings = verify_package(package).findings
    assert {finding.file for finding in findings} <= {path}
    return [finding.text for finding in findings]


def test_pages_that_follow_from_the_files_are_sound(paged: Path) -> None:
    verdict = verify_package(paged)
    assert (verdict.findings, [note for note in verdict.notes if "html" in note]) == ([], [])


@pytest.mark.parametrize("path", [AUDIT_PAGE, REPORT])
def test_a_stand_in_that_is_taken_out_of_a_page_is_found(own_paged: Path, path: str) -> None:
    edit(own_paged, path, lambda page: page.replace("stand-in", "vehicle", 1))
    (text,) = texts_in(own_paged, path)
    assert "vehicle" in text
    assert "and the files of the package give" in text


def test_a_helper_process_finds_what_one_process_finds(own_paged: Path) -> None:
    for path in (AUDIT_PAGE, REPORT):
        edit(own_paged, path, lambda page: page.replace("stand-in", "vehicle", 1))
    alone = verify_package(own_paged)
    assert [finding.file for finding in alone.findings] == [AUDIT_PAGE, REPORT]
    assert verify_package(own_paged, workers=2) == alone


def test_a_picture_of_something_else_is_found(own_paged: Path) -> None:
    data = cv2.imencode(".jpg", np.full((54, 96, 3), 200, np.uint8))[1].tobytes()
    marker = "data:image/jpeg;base64,"

    def other_picture(page: str) -> str:
        before, _, after = page.partition(marker)
        return before + marker + base64.b64encode(data).decode() + after[after.index('"') :]

    edit(own_paged, AUDIT_PAGE, other_picture)
    (text,) = texts_in(own_paged, AUDIT_PAGE)
    assert text == "shows another picture than the package holds: number 1 of the page"


def carrying(page: str, **changed: object) -> str:
    """The page with other options in it."""
    before, start, rest = page.partition('<meta name="ssp-report" content="')
    content, end, after = rest.partition('"')
    making = Making.model_validate({**json.loads(html.unescape(content)), **changed})
    return f"{before}{start}{escape(making.model_dump_json())}{end}{after}"


def test_options_that_a_page_was_not_made_with_are_found(own_paged: Path) -> None:
    edit(own_paged, REPORT, lambda page: carrying(page, expected=["cut_in", "vru_crossing"]))
    (text,) = texts_in(own_paged, REPORT)
    assert "the files of the package give" in text


def test_a_page_that_says_no_options_is_found(own_paged: Path) -> None:
    edit(own_paged, REPORT, lambda page: page.replace("ssp-report", "ssp-other", 1))
    (text,) = texts_in(own_paged, REPORT)
    assert text.startswith("doesn't say by which options it was made")


def test_a_page_of_another_version_is_said_not_to_be_compared(own_paged: Path) -> None:
    edit(own_paged, REPORT, lambda page: carrying(page, software="ssp 0.0.1"))
    verdict = verify_package(own_paged)
    assert verdict.findings == []
    assert any(f"{REPORT}: made by ssp 0.0.1, and not compared" in note for note in verdict.notes)
    assert f"for people, and held against nothing: {REPORT}" in verdict.notes


def test_details_beside_a_large_page_are_compared(
    evidence: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ssp_eval.report.page.MOST_IN_ONE_FILE", 0)
    campaign = Path(shutil.copytree(evidence, tmp_path / "demo"))
    assert main(["report", str(campaign), "--resamples", "200"]) == 0
    details = sorted((campaign / "report" / "cells").glob("*.js"))
    make_package([campaign], tmp_path / "package")
    assert verify_package(tmp_path / "package").findings == []
    path = f"demo/{details[0].relative_to(campaign)}"
    edit(tmp_path / "package", path, lambda text: text.replace("maintain", "brake", 1))
    assert len(texts_in(tmp_path / "package", path)) == 1


def picture(level: int) -> str:
    data = cv2.imencode(".jpg", np.full((54, 96, 3), level, np.uint8))[1].tobytes()
    return f'<img src="data:image/jpeg;base64,{base64.b64encode(data).decode()}">'


def test_a_rounded_grey_level_is_no_other_picture() -> None:
    assert difference(picture(100), picture(101)) == ""
    assert "another picture" in difference(picture(100), picture(104))
    assert "another picture" in difference('<img src="data:image/jpeg;base64,AAA">', picture(1))
    assert difference("a", "ab") == "says …a…, and the files of the package give …ab…"
