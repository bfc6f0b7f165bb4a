"""What was asked and what came of it, and the form in which it is stored."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from ssp_core.errors import InputError
from ssp_core.hashing import sha256_json
from ssp_eval.evaluate.asker import Loss
from ssp_vla_bridge.messages import (
    CameraGeometry,
    EgoSample,
    Frame,
    Request,
    Response,
    response_to_json,
)

RAW_FILE = "raw.jsonl"
REQUESTS_FILE = "requests.jsonl"
EARLIER_FILE = "earlier.jsonl"
REQUEST_SCHEMA = "ssp.request/1"


# In an answer and its decoding facts these tell how it came, not what it says.
_OF_DELIVERY = ("request_id", "latency_s", "timeout_s", "tries")


def answer_sha256(response: Response) -> str:
    """Hash of what a model said, whenever and however fast it did, and in however many tries."""
    value = _said(response_to_json(response))
    decoding = _said(value["decoding"])
    stages = decoding.get("stages")
    if isinstance(stages, list):
        decoding["stages"] = [_said(one) if isinstance(one, dict) else one for one in stages]
    return sha256_json({**value, "decoding": decoding})


def _said(facts: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in facts.items() if key not in _OF_DELIVERY}


def request_to_json(request: Request) -> dict[str, Any]:
    """What was asked, with the frames as hashes and the previous answer as id and hash."""
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


def asked_again(value: Mapping[str, Any], previous: Response | None) -> Request:
    """What a stored question tells an adapter: all but the pictures themselves.

    Args:
        value: a line of requests.jsonl that was asked.
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
        raise InputError(f"is no question that was asked: {error}") from error


@dataclass(frozen=True)
class Asked:
    """One label time of a cell: what was asked, and what came of it.

    Args:
        label_t_s: clip time of the label.
        t_s: clip time of the newest frame sent, None where nothing could be asked.
        request: as sent, None where nothing could be asked.
        response: the raw answer, None where there is none.
        missing: why there is no record, empty where there is one.
        loss: the kind of that reason, None where there is a record.
        reused: the answer was stored by an earlier run.
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
