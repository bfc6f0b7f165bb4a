"""The stored questions and their outcomes, and the key that finds them again."""

from __future__ import annotations

import secrets
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from ssp_core.errors import InputError
from ssp_core.hashing import sha256_file, sha256_json
from ssp_eval.evaluate.clients.model_replies import Loss
from ssp_eval.evaluate.clients.models import CONDITION_SEED, ModelSpec
from ssp_vla_bridge.backend import telling_options
from ssp_vla_bridge.backends.python import split
from ssp_vla_bridge.messages import (
    CameraGeometry,
    EgoSample,
    Frame,
    Request,
    Response,
    response_to_json,
)
from ssp_vla_bridge.prompts import words_sha256

RAW_FILE = "raw.jsonl"
REQUESTS_FILE = "requests.jsonl"
EARLIER_FILE = "earlier.jsonl"
REQUEST_SCHEMA = "ssp.request/1"


# In an answer and its decoding facts these tell how it came, not what it says.
_OF_DELIVERY = ("request_id", "latency_s", "timeout_s", "tries")


def answer_sha256(response: Response) -> str:
    """Hash of what a model said, whenever and however fast it did, and in however many tries."""
    value = _answer_facts(response_to_json(response))
    decoding = _answer_facts(value["decoding"])
    stages = decoding.get("stages")
    if isinstance(stages, list):
        decoding["stages"] = [
            _answer_facts(one) if isinstance(one, dict) else one for one in stages
        ]
    return sha256_json({**value, "decoding": decoding})


def _answer_facts(facts: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in facts.items() if key not in _OF_DELIVERY}


def request_to_json(request: Request) -> dict[str, Any]:
    """Serialise a request, with the frames as hashes and the previous answer as id and hash."""
    previous = request.previous
    return {
        "schema": REQUEST_SCHEMA,
        "request_id": request.request_id,
        "stamp_ns": request.stamp_ns,
        "frames": [
            {"stamp_ns": frame.stamp_ns, "sha256": frame.sha256} for frame in request.frames
        ],
        "camera": None if request.camera is None else asdict(request.camera),
        # A copy of flat fields, where asdict would go into each number.
        "history": [dict(vars(sample)) for sample in request.history],
        "ego_provenance": request.ego_provenance,
        "previous": None
        if previous is None
        else {"request_id": previous.request_id, "sha256": answer_sha256(previous)},
    }


def rebuild_request(value: Mapping[str, Any], previous: Response | None) -> Request:
    """Rebuild a stored question for an adapter: all but the pictures themselves.

    Args:
        value: a line of requests.jsonl.
        previous: the answer that the line names as the one before.

    Raises:
        InputError: it is no such line.
    """
    try:
        camera = value["camera"]
        return Request(
            request_id=str(value["request_id"]),
            stamp_ns=int(value["stamp_ns"]),
            frames=tuple(Frame(int(frame["stamp_ns"]), b"") for frame in value["frames"]),
            camera=None if camera is None else CameraGeometry(**camera),
            history=tuple(EgoSample(**sample) for sample in value["history"]),
            ego_provenance=str(value["ego_provenance"]),
            previous=previous,
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"is no question that was asked: {error}",
            remedy="put the file back, or give the same `ssp evaluate` command again",
        ) from error


@dataclass(frozen=True)
class Exchange:
    """One label time of a cell: what was asked, and what came of it.

    Args:
        t_s: clip time of the newest frame sent, None where nothing could be asked.
        request: as sent, None where nothing could be asked.
        response: the raw answer, None where there is none.
        missing: why there is no record, empty where there is one.
        loss: the kind of that reason, None where there is a record.
        again: how often the question was repeated after an error.
        no_previous: why the request holds no previous answer though the interface carries one;
            empty where it holds one, or where there could be none.
    """

    label_t_s: float
    t_s: float | None
    request: Request | None
    response: Response | None
    missing: str = ""
    loss: Loss | None = None
    reused: bool = False
    again: int = 0
    no_previous: str = ""

    @property
    def record_from(self) -> Response | None:
        """The response that makes a record, None where the output is missing."""
        return None if self.missing else self.response


_DIGITS = 32


class AnswerKeys:
    """The keys of one cell.

    Args:
        labels_sha256: hash of what the labels say, which only the control that answers from them
            depends on.
        clip_start_ns: stamp of the clip's time 0, which only that control receives.
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
    """Return an id that tells what was asked, and is never used twice."""
    return f"{key}-{secrets.token_hex(4)}"


def key_of(request_id: str) -> str:
    """Return the key in an id of new_request_id."""
    return request_id.partition("-")[0]


def model_facts(model: ModelSpec, labels_sha256: str, clip_start_ns: int) -> dict[str, Any]:
    """Return the facts that an answer depends on besides its request, as JSON values."""
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
        source = _source(module, options)
        if source:
            facts["source"] = source
            options.pop("folder", None)
    if ":" in backend and (source := _source(backend.partition(":")[0], {})):
        facts["source"] = source
    return {
        **facts,
        "model": model.name,
        "backend": backend,
        "interface": model.model_interface.name,
        "options": options,
    }


def _content(path: Path) -> list[str]:
    """Return the hashes of the files with the answers of a recording (recorded.read_stored)."""
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
    """Hash the file of a module, looked for where its bridge will; empty: none is found.

    The module isn't imported: it may load a model.

    Args:
        module: dotted name.
        options: of the backend python, whose ``folder`` comes first; the working folder is last.
    """
    parts = module.split(".")
    if not all(parts):
        return ""
    first = [str(options["folder"])] if "folder" in options else []
    for place in (*first, *sys.path, "."):
        path = Path(place, *parts)
        for file in (path / "__init__.py", path.with_name(f"{path.name}.py")):
            if file.is_file():
                return sha256_file(file)
    return ""
