"""The conventions for reviewers and for the LLM; the words stand in ``conventions.yaml``."""

from __future__ import annotations

from pathlib import Path

import yaml

_READ = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))
GENERAL: tuple[str, ...] = tuple(_READ["general"])
REVIEWERS_TOO: str = _READ["reviewers"]
ASKED: dict[str, str] = {slot: told["asked"] for slot, told in _READ["slots"].items()}
CONVENTIONS: dict[str, str] = {slot: told["rule"] for slot, told in _READ["slots"].items()}
