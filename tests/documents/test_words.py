"""The words of messages, pages and documents name their subject."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
SOURCES = [*sorted(p.parent.name for p in ROOT.glob("ssp_*/package.xml")), "bootstrap"]
# What is "told apart" or "told to" do something has a subject beside it.
NO_SUBJECT = re.compile(r"\b(nobody|whoever|told(?! apart| to\b))\b", re.IGNORECASE)
# Words of the language that texts are read by, and prompts whose hash stands in recordings.
LANGUAGE = (
    "ssp_eval/ssp_eval/extract/",
    "ssp_vla_bridge/ssp_vla_bridge/adapters/plan_label.py",
    "ssp_vla_bridge/ssp_vla_bridge/prompts.py",
)
CODE = re.compile(r"^```.*?^```|`[^`]*`|^    .*?$", re.S | re.M)
# Names and comparisons in templates, style and scripts of pages.
MARKUP = re.compile(
    r"\{%.*?%\}|\{\{.*?\}\}|\{#.*?#\}|<style.*?</style>|<script.*?</script>|<[^>]*>", re.S
)
QUOTED = re.compile(r'"[^"\n]*"')


def shipped(*patterns: str) -> list[Path]:
    """The files of the packages that aren't tests and aren't of the language."""
    found = (file for name in SOURCES for one in patterns for file in (ROOT / name).rglob(one))
    return [
        file
        for file in sorted(found)
        if "test" not in file.relative_to(ROOT).parts
        and not str(file.relative_to(ROOT)).startswith(LANGUAGE)
    ]


def messages(file: Path) -> Iterator[str]:
    """The strings of a source that are sentences, without docstrings and regular expressions."""
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    tree = ast.parse(file.read_text())
    docs = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, documented) and node.body and isinstance(node.body[0], ast.Expr)
    }
    expressions = {
        id(part)
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "re.compile"
        for part in ast.walk(node)
    }
    skipped = docs | expressions
    for node in ast.walk(tree):
        if not isinstance(node, ast.Constant) or id(node) in skipped:
            continue
        if isinstance(node.value, str) and " " in node.value.strip():
            yield node.value


def texts(value: Any) -> Iterator[str]:
    """The sentences among the values of a YAML file."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        for one in value:
            yield from texts(one)
    elif isinstance(value, str) and " " in value.strip():
        yield value


def without_subject(file: Path, sentences: Iterator[str]) -> list[str]:
    where = file.relative_to(ROOT)
    return [f"{where}: {one}" for one in sentences if NO_SUBJECT.search(one)]


@pytest.mark.parametrize("folder", SOURCES)
def test_messages_name_their_subject(folder: str) -> None:
    files = [file for file in shipped("*.py") if file.relative_to(ROOT).parts[0] == folder]
    assert files
    found = [line for file in files for line in without_subject(file, messages(file))]
    assert not found, "\n".join(found)


def test_pages_name_their_subject() -> None:
    files = shipped("*.j2", "*.html")
    assert files
    found = []
    for file in files:
        text = file.read_text()
        found += without_subject(file, iter(MARKUP.sub(" ", text).splitlines()))
        # A value that stands in for a missing one is shown too.
        shown = "".join(re.findall(r"\{\{.*?\}\}", text))
        found += without_subject(file, iter(QUOTED.findall(shown)))
    assert not found, "\n".join(found)


def test_texts_of_data_files_name_their_subject() -> None:
    files = [file for file in shipped("*.yaml") if "library" in file.parts]
    assert files
    found = []
    for file in files:
        for document in yaml.safe_load_all(file.read_text()):
            found += without_subject(file, texts(document))
    assert not found, "\n".join(found)


def test_documents_name_their_subject() -> None:
    """Code and quoted words of others, such as old messages in the changelog, don't count."""
    files = [
        *(ROOT / "docs").rglob("*.md"),
        *ROOT.glob("*.md"),
        *ROOT.glob("ssp_*/README.md"),
        *(ROOT / ".github").rglob("*.md"),
    ]
    assert len(files) > 50
    found = []
    for file in sorted(files):
        text = QUOTED.sub(" ", CODE.sub(" ", file.read_text()))
        found += [
            f"{file.relative_to(ROOT)}: {line}"
            for line in text.splitlines()
            if NO_SUBJECT.search(line)
        ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("sentence", "named"),
    [
        ("Nobody commands any more.", False),
        ("whoever opens it adds work", False),
        ("its times can't be told", False),
        ("lines can't be told apart", True),
        ("the server was told to spawn", True),
    ],
)
def test_the_words_that_stand_in_place_of_a_subject_are_seen(sentence: str, named: bool) -> None:
    assert (NO_SUBJECT.search(sentence) is None) is named
