"""The key under which an answer is stored: all that it depends on, and nothing else.

In it: the request as it is asked (frames, ego history, camera, task, the model's answer before),
the words in which a backend of ours asks it, and of the model its name, backend, interface, the
options that can change what it says, and the condition. Files are in it by what they hold, wherever
they lie. Not in it: what decides whether and when an answer comes (times, tries, the variable with
a key), which adapter or extractor reads it, what reports say of the model, and the rules by which
the request was made, since it is there itself.
"""

from __future__ import annotations

import secrets
import sys
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from ssp_core.hashing import sha256_file, sha256_json
from ssp_eval.evaluate.controls import CONDITION_SEED
from ssp_eval.evaluate.model_spec import ModelSpec
from ssp_eval.evaluate.store import RAW_FILE, answer_sha256, request_to_json
from ssp_vla_bridge.backend import telling_options
from ssp_vla_bridge.backends.python import split
from ssp_vla_bridge.messages import Request
from ssp_vla_bridge.prompts import words_sha256

_DIGITS = 32


class AnswerKeys:
    """The keys of one cell.

    Args:
        model: who is asked.
        labels_sha256: hash of what the labels say, which only the control that answers from them
            depends on.
        clip_start_ns: stamp of the clip's time 0, which only that control is told.
    """

    def __init__(self, model: ModelSpec, labels_sha256: str, clip_start_ns: int) -> None:
        self._model = model
        self._facts = model_facts(model, labels_sha256, clip_start_ns)

    def of(self, request: Request) -> str:
        """Hash of everything that the answer to a request may depend on."""
        previous, model = request.previous, self._model
        content = {
            "request": request_to_json(replace(request, request_id="", previous=None)),
            "previous": None if previous is None else answer_sha256(previous),
            "task": asdict(request.task),
            # Of a bridge that isn't ours nobody here knows its words.
            "words": None
            if model.attached
            else words_sha256(model.backend_name, model.options, request),
            "model": self._facts,
        }
        return sha256_json(content).removeprefix("sha256:")[:_DIGITS]


def new_request_id(key: str) -> str:
    """An id that tells what was asked, and is never used twice."""
    return f"{key}-{secrets.token_hex(4)}"


def key_of(request_id: str) -> str:
    """The key in an id of new_request_id."""
    return request_id.partition("-")[0]


def model_facts(model: ModelSpec, labels_sha256: str, clip_start_ns: int) -> dict[str, Any]:
    """What an answer depends on besides its request, as JSON values.

    Args:
        model, labels_sha256, clip_start_ns: see AnswerKeys.
    """
    backend = model.backend_name
    options = telling_options(backend, model.options_for(labels_sha256, clip_start_ns))
    facts: dict[str, Any] = {}
    if model.condition:
        facts["condition"] = [model.condition, CONDITION_SEED]
    if backend == "recorded" and "file" in options:
        options["file"] = _content(Path(str(options["file"])))
    if backend == "perfect" and Path(str(options.get("labels_file"))).is_file():
        options["labels_file"] = sha256_file(str(options["labels_file"]))
    if backend == "python" and "function" in options:
        module, _ = split(str(options["function"]))
        found = _source(module, options)
        if found:
            facts["source"] = found
            options.pop("folder", None)
    if ":" in backend and (found := _source(backend.partition(":")[0], {})):
        facts["source"] = found
    return {
        **facts,
        "model": model.name,
        "backend": backend,
        "interface": model.spoken.name,
        "options": options,
    }


def _content(path: Path) -> list[str]:
    """Hashes of the files with the answers of a recording (stored_answers.read_stored)."""
    if path.is_file():
        files = [path]
    elif (path / RAW_FILE).is_file():
        files = [path / RAW_FILE]
    elif (path / "metadata.yaml").is_file():
        files = list(path.glob("*.mcap"))
    else:
        files = list(path.glob(f"cells/*/{RAW_FILE}"))
    return sorted(sha256_file(file) for file in files)


def _source(module: str, options: Mapping[str, Any]) -> str:
    """Hash of the file that a module is, looked for where its bridge will; empty: none found.

    The module isn't imported: it may load a model.

    Args:
        module: its full name.
        options: of the backend python, whose ``folder`` comes first.
    """
    parts = module.split(".")
    if not all(parts):
        return ""
    for place in (str(options.get("folder", ".")), *sys.path):
        path = Path(place, *parts)
        for file in (path.with_name(f"{path.name}.py"), path / "__init__.py"):
            if file.is_file():
                return sha256_file(file)
    return ""
