"""The page's own files, read once: nothing else is ever served."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ssp_core.errors import HostError

FOLDER = Path(__file__).parent / "static"
_TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript"}


@dataclass(frozen=True, slots=True)
class Asset:
    """One file as it goes out."""

    body: bytes
    content_type: str


def load_assets(folder: Path = FOLDER) -> dict[str, Asset]:
    """The files by the path under which they are served; ``/`` is the page.

    Raises:
        HostError: the installation lacks the page.
    """
    found = {
        f"/{path.name}": Asset(path.read_bytes(), _TYPES[path.suffix])
        for path in sorted(folder.glob("*"))
        if path.suffix in _TYPES
    }
    if "/index.html" not in found:
        raise HostError(f"{folder} has no index.html: this installation lacks the operators' page")
    found["/"] = found.pop("/index.html")
    return found
