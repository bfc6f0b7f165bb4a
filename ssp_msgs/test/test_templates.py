"""Templates are compiled once in a process."""

from __future__ import annotations

from pathlib import Path

import jinja2
import pytest

from ssp_core.templates import templates


def test_a_template_is_compiled_once_whichever_page_asks_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "page.html.j2").write_text("<p>{{ text }}</p>")
    first = templates(tmp_path).get_template("page.html.j2").render(text="a < b")
    monkeypatch.setattr(jinja2.Environment, "compile", None)
    assert templates(tmp_path).get_template("page.html.j2").render(text="c") == "<p>c</p>"
    assert first == "<p>a &lt; b</p>"
