"""A model of a campaign: who it is, how it is asked, and how its answers are read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from ssp_core.hashing import sha256_file, sha256_json
from ssp_eval.evaluate.controls import CLIP_START_NS, CONDITION_SEED, LABELS_FILE
from ssp_vla_bridge.core.adapters import check_adapter
from ssp_vla_bridge.core.backend import interface_of
from ssp_vla_bridge.core.interfaces import Interface, find_interface
from ssp_vla_bridge.core.window import Preprocessing

# A deadline decides whether an answer comes, not what it says.
_NOT_IN_KEYS = ("timeout_s",)


@dataclass(frozen=True)
class ModelFacts:
    """What reports say of a model; nothing here changes how it is asked or scored.

    Args:
        total_b: parameters, billions; None where nobody says.
        active_b: parameters that one token uses, billions; None where nobody says.
        architecture: a word such as ``dense`` or ``moe``; empty where nobody says.
    """

    total_b: float | None = None
    active_b: float | None = None
    architecture: str = ""


@dataclass(frozen=True)
class ModelSpec:
    """One model of a campaign.

    Args:
        name: on the topics and in the results.
        options: of its backend; placeholders stand for what differs from cell to cell.
        attached: its bridge runs already, and isn't ours to start or stop.
        backend: name of a backend or ``module:factory``; empty: the model's name.
        interface: that it speaks; empty: the one of its backend and options.
        adapter: that reads its answers, ``name`` or ``name:mode``; empty: the interface's.
        timeout_s: for one answer; None: the campaign's.
        preprocessing: what differs from the interface's, by field of Preprocessing.
        facts: for reports.
        condition: under which it is asked (conditions.py); empty: as it is meant to be.
        control: it was added to check the harness, whatever it is; it enters no mean and no rank.
    """

    name: str
    options: Mapping[str, Any] = field(default_factory=dict)
    attached: bool = False
    backend: str = ""
    interface: str = ""
    adapter: str = ""
    timeout_s: float | None = None
    preprocessing: Mapping[str, Any] = field(default_factory=dict)
    facts: ModelFacts = ModelFacts()
    condition: str = ""
    control: bool = False

    @property
    def shown(self) -> str:
        """Its name in results, such as ``mine+black``: under a condition it is another cell."""
        return f"{self.name}+{self.condition}" if self.condition else self.name

    @property
    def backend_name(self) -> str:
        """The backend that answers; of an attached bridge it is known only if somebody says."""
        return self.backend or self.name

    @property
    def spoken(self) -> Interface:
        """What the model expects and gives.

        Raises:
            InputError: there is no such interface.
        """
        return find_interface(self.interface or interface_of(self.backend_name, self.options))

    @property
    def rules(self) -> Preprocessing:
        """Which frames and ego samples its requests hold."""
        return replace(self.spoken.preprocessing, **self.preprocessing)

    def read_by(self, override: str = "") -> str:
        """The adapter with its mode, as it stands in results.

        Args:
            override: adapter of the whole campaign; empty: the model's own.

        Raises:
            InputError: there is no such adapter.
        """
        return ":".join(check_adapter(override or self.adapter or self.spoken.adapter))

    def options_for(self, labels_file: str, clip_start_ns: int) -> dict[str, Any]:
        """The backend's options for one cell."""
        return _filled(self.options, {LABELS_FILE: labels_file, CLIP_START_NS: clip_start_ns})

    def key_facts(self, labels_sha256: str) -> dict[str, Any]:
        """All that an answer depends on besides its request: content instead of places.

        The adapter is none of it: it reads what is stored.

        Args:
            labels_sha256: stands for the labels file that a control reads.
        """
        options = _filled(self.options, {LABELS_FILE: labels_sha256})
        if self.backend_name == "recorded" and "file" in options:
            options["file"] = _content(Path(str(options["file"])))
        if self.backend_name == "python" and "function" in options:
            options["function"] = [options["function"], *_source(options)]
        condition = {"condition": [self.condition, CONDITION_SEED]} if self.condition else {}
        return {
            **condition,
            "model": self.name,
            "backend": self.backend_name,
            "interface": self.spoken.name,
            "preprocessing": sha256_json(asdict(self.rules)),
            "options": {k: v for k, v in options.items() if k not in _NOT_IN_KEYS},
        }


def _content(path: Path) -> list[str]:
    """Hashes of what a recording of answers holds, be it a file, a folder or a bag."""
    patterns = ("*.jsonl", "*.mcap")
    files = [path] if path.is_file() else [f for p in patterns for f in path.rglob(p)]
    return sorted(sha256_file(file) for file in files)


def _source(options: Mapping[str, Any]) -> list[str]:
    """Hash of the file that a Python function stands in; none where it is an installed package.

    Args:
        options: of the backend python: ``function``, and the ``folder`` of its module.
    """
    name = str(options["function"])
    module = name.partition(":")[0] if ":" in name else name.rpartition(".")[0]
    place = Path(str(options.get("folder", ".")), *module.split("."))
    files = (place.with_name(f"{place.name}.py"), place / "__init__.py")
    return [sha256_file(file) for file in files if module and file.is_file()]


def _filled(options: Mapping[str, Any], places: Mapping[str, Any]) -> dict[str, Any]:
    return {
        key: places.get(value, value) if isinstance(value, str) else value
        for key, value in options.items()
    }
