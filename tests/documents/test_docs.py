"""The things that the documents refer to exist."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

from ssp_core.cli import VERBS

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = [
    *(ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")),
    ROOT / "llms.txt",
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


def test_the_page_of_commands_has_every_verb() -> None:
    text = (ROOT / "docs" / "commands.md").read_text()
    assert set(re.findall(r"\./ssp ([a-z][a-z-]*)", text)) == set(VERBS)


def test_the_readme_leads_to_few_pages() -> None:
    """A newcomer sees where to go; the pages of each command stand on one of their own."""
    assert (ROOT / "README.md").read_text().count("](") <= 25


@pytest.mark.parametrize(
    "package",
    [
        "ssp_core",
        "ssp_scenario_manager",
        "ssp_ot_controller",
        "ssp_monitor",
        "ssp_vla_bridge",
        "ssp_eval",
    ],
)
def test_the_public_names_of_a_package_are_those_of_the_page(package: str) -> None:
    module = importlib.import_module(package)
    for name, place in module.PUBLIC.items():
        assert getattr(module, name) is getattr(importlib.import_module(place), name)
        assert getattr(module, name).__doc__
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = module.nothing
    page = (ROOT / "docs" / "api.md").read_text()
    named = re.findall(rf"^::: ({package}\..+)$", page, re.M)
    assert named == [f"{place}.{name}" for name, place in module.PUBLIC.items()]


def test_the_architecture_names_functions_that_are_there() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text()
    named = re.findall(r"\| ((?:`[\w.]+`(?:, )?)+) \| (ssp_\w+): `([\w/.]+)` \|", text)
    named += re.findall(r"(`[\w.]+`)\s\(?(?:in )?(ssp_\w+): `([\w/.]+)`", text)
    assert len(named) >= 30
    for names, package, file in named:
        source = ROOT / ("ssp_msgs" if package == "ssp_core" else package) / package / file
        code = source.read_text()
        for name in re.findall(r"`([\w.]+)`", names):
            owner, _, method = name.rpartition(".")
            assert not owner or re.search(rf"^class {owner}\b", code, re.M), name
            start = r"^    (?:async )?def" if owner else r"^(?:def|class)"
            assert re.search(rf"(?:{start} {method}\b|^{method}\b.* = )", code, re.M), name


def test_the_site_has_every_page() -> None:
    text = (ROOT / "mkdocs.yml").read_text().split("\nnav:\n")[1]
    named = re.findall(r"- (\S+\.md)$", text, re.M)
    assert len(named) == len(set(named))
    pages = {str(file.relative_to(ROOT / "docs")) for file in (ROOT / "docs").rglob("*.md")}
    # Those that lie elsewhere are brought in by docs/site.py.
    elsewhere = re.findall(
        r'^    "[^"]+": "([\w-]+\.md)",$', (ROOT / "docs/site.py").read_text(), re.M
    )
    assert set(named) == pages | set(elsewhere)
