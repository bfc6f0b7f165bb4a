"""What the documents say must be there is there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from ssp_core.cli import VERBS

ROOT = Path(__file__).resolve().parent.parent
DOCUMENTS = [
    ROOT / "README.md",
    ROOT / "CHANGELOG.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted(ROOT.glob("ssp_*/README.md")),
]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_lead_somewhere_and_nothing_is_left_to_fill_in(document: Path) -> None:
    text = document.read_text()
    assert not re.search(r"@[A-Z]+@", text)
    for target in re.findall(r"\]\(([^)#]+)\)", text):
        if "://" not in target:
            assert (document.parent / target).exists(), target


def test_the_readme_names_every_verb_but_no_other() -> None:
    named = set(re.findall(r"\./ssp ([a-z][a-z-]*)", (ROOT / "README.md").read_text()))
    # The launcher's own: it prints the environment that the command line is called in.
    assert named == {*VERBS, "env"}
