"""Recognition of a campaign of driven runs, without the modules that read it."""

from __future__ import annotations

from pathlib import Path


def is_loop_campaign(folder: Path) -> bool:
    """Tell whether ``ssp loop`` wrote a folder: it has a plan and sealed starts."""
    return (folder / "plan.json").is_file() and (folder / "starts.json").is_file()
