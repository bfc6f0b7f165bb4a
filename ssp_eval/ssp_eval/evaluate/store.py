"""Raw answers on disk: written before anything interprets them, found again by what was asked."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ssp_core.errors import HostError, InputError
from ssp_core.files import write_text
from ssp_core.hashing import sha256_json
from ssp_eval.evaluate.asker import Loss
from ssp_vla_bridge.core.request import CameraGeometry, EgoSample, Frame, Request
from ssp_vla_bridge.core.response import Response, response_from_json, response_to_json

RAW_FILE = "raw.jsonl"
REQUESTS_FILE = "requests.jsonl"
REQUEST_SCHEMA = "ssp.request/1"


def answer_sha256(response: Response) -> str:
    """Hash of what a model said, whenever and however fast it did."""
    value = response_to_json(response)
    return sha256_json({k: v for k, v in value.items() if k not in ("request_id", "latency_s")})


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


class RawStore:
    """The raw answers of one cell, appended one by one and safe against a kill at any time.

    Args:
        cell: the cell's folder.

    Raises:
        InputError: the stored answers can't be read.
    """

    def __init__(self, cell: Path) -> None:
        self._path = cell / RAW_FILE
        self._requests_path = cell / REQUESTS_FILE
        self._by_key: dict[str, Response] = {}
        self._unfinished_at: int | None = None  # where a line begins that a kill cut off
        if self._path.exists():
            self._load()

    def _load(self) -> None:
        content = self._path.read_bytes()
        lines = content.split(b"\n")
        for number, line in enumerate(lines, start=1):
            if not line.strip():
                continue
            try:
                value = json.loads(line)
            except ValueError as error:
                if number == len(lines):
                    # A run was killed while it wrote this line; it is asked again.
                    self._unfinished_at = len(content) - len(line)
                    return
                raise InputError(f"is no JSON: {error}", file=self._path, line=number) from error
            response = response_from_json(value, file=str(self._path), line=number)
            if not response.error_code:
                self._by_key[response.request_id.split("-")[0]] = response

    def find(self, key: str) -> Response | None:
        """The stored answer to the same question; errors don't count as answers."""
        return self._by_key.get(key)

    def forget(self) -> None:
        """Makes everything be asked again; what is on disk stays until ``finish``."""
        self._by_key.clear()

    def append(self, response: Response) -> None:
        """Stores a raw answer, on disk when this returns.

        Raises:
            HostError: the disk doesn't take it.
        """
        line = json.dumps(response_to_json(response), allow_nan=False) + "\n"
        try:
            with open(self._path, "ab+") as stream:
                if self._unfinished_at is not None:
                    # It would be a fault in the middle of the file for the run after the next kill.
                    stream.truncate(self._unfinished_at)
                    stream.seek(0, os.SEEK_END)
                    self._unfinished_at = None
                if stream.tell() and not _ends_with_newline(stream):
                    stream.write(b"\n")
                stream.write(line.encode())
                stream.flush()
                os.fsync(stream.fileno())
        except OSError as error:
            raise HostError(f"{self._path}: can't be written: {error.strerror}") from error

    def finish(self, asked: Sequence[Asked]) -> None:
        """Leaves exactly one line per answered label time, in order, and what was asked."""
        answers = [response_to_json(one.response) for one in asked if one.response is not None]
        _write_lines(self._path, answers)
        requests = []
        for one in asked:
            sent = {} if one.request is None else request_to_json(one.request)
            if one.response is not None:
                sent["request_id"] = one.response.request_id
            place = {
                "label_t_s": one.label_t_s,
                "t_s": one.t_s,
                "missing": one.missing,
                "kind": one.loss,
                "no_previous": one.no_previous,
            }
            requests.append({**place, **sent})
        _write_lines(self._requests_path, requests)


def _ends_with_newline(stream: Any) -> bool:
    stream.seek(-1, os.SEEK_END)
    return bool(stream.read(1) == b"\n")


def _write_lines(path: Path, values: Sequence[dict[str, Any]]) -> None:
    lines = [json.dumps(value, allow_nan=False) for value in values]
    write_text(path, "".join(line + "\n" for line in lines))
