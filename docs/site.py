"""Brings the pages that lie beside the code into the site, and turns its links to them.

A hook of MkDocs. What a page names in the source tree has no page: such a link becomes its text.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parent.parent
# The site's page of each document outside docs/.
PAGES = {
    "README.md": "index.md",
    "CHANGELOG.md": "whats-new.md",
    "CONTRIBUTING.md": "contributing.md",
    "SECURITY.md": "security.md",
    "ssp_vla_bridge/README.md": "attach-a-model.md",
    "ssp_vla_bridge/sidecars/README.md": "sidecars.md",
    "tests/bench/README.md": "bench.md",
    "tests/fuzz/README.md": "fuzzing.md",
    "tests/golden/README.md": "golden.md",
    "ssp_eval/test/corpus/README.md": "corpus.md",
}
SOURCES = {page: document for document, page in PAGES.items()}
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s]+)\)")


def on_files(files: Files, config: Any, **_: Any) -> Files:
    """Add the pages that lie outside docs/."""
    for document, page in PAGES.items():
        files.append(File.generated(config, page, abs_src_path=str(ROOT / document)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Turn the links of a page, which lead to files of the tree, into links of the site."""
    here = page.file.src_uri
    source = SOURCES.get(here, f"docs/{here}")

    def turned(link: re.Match[str]) -> str:
        mark, text, target = link.groups()
        if "://" in target or target.startswith("#"):
            return link[0]
        path, sign, anchor = target.partition("#")
        file = posixpath.normpath(posixpath.join(posixpath.dirname(source), path))
        on_site = PAGES.get(file, file.removeprefix("docs/") if file.startswith("docs/") else None)
        if file == "docs/decisions":
            on_site = "decisions/0001-lockstep-by-counts.md"
        if on_site is None:
            return text if mark or "`" in text else f"`{text}`"
        relative = posixpath.relpath(on_site, posixpath.dirname(here) or ".")
        return f"{mark}[{text}]({relative}{sign}{anchor})"

    return LINK.sub(turned, markdown)
