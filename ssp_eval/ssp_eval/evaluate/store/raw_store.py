"""Raw answers on disk: written before anything interprets them, found again by what was asked.

``raw.jsonl`` holds the answers that a cell's score rests on, one line per answered label time.
``earlier.jsonl`` holds those that were asked with other settings or about other label times, so
that going back to these asks, and pays, for nothing: one line per key, no errors, and no answer
that stands in ``raw.jsonl`` or that a newer one to the same question has replaced. It may be
deleted at any time. Both are as the last finished run left them, or nothing of them is used; a run
that goes on removes the cell.json that names them before it changes them.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from ssp_core.errors import InputError, not_written
from ssp_core.files.reading import read_json_mapping
from ssp_core.files.strict_json import parse_json_line
from ssp_core.files.writing import write_text
from ssp_core.hashing import sha256_file
from ssp_eval.evaluate.store.cell_file import CELL_FILE, remove_file
from ssp_eval.evaluate.store.requests import (
    EARLIER_FILE,
    RAW_FILE,
    REQUESTS_FILE,
    Exchange,
    key_of,
    request_to_json,
)
from ssp_vla_bridge.backend import with_end_read
from ssp_vla_bridge.messages import ErrorCode, Response, response_from_json, response_to_json


def check_unchanged(cell: Path) -> None:
    """Refuse stored answers that aren't as the last finished run left them.

    Args:
        cell: the cell's folder; it need not be there.

    Raises:
        InputError: a file of them was changed.
    """
    try:
        hashes = read_json_mapping(cell / CELL_FILE).get("hashes")
    except InputError:
        return  # no run has finished here
    for path in (cell / RAW_FILE, cell / EARLIER_FILE):
        if (
            path.is_file()
            and isinstance(hashes, dict)
            and sha256_file(path) != hashes.get(path.stem)
        ):
            raise InputError(
                "was changed since the cell was evaluated",
                file=path,
                remedy="put it back, or remove the cell's folder: all of it is asked again",
            )


class RawStore:
    """The raw answers of one cell, appended one by one and safe against a kill at any time.

    Raises:
        InputError: the stored answers can't be read.
    """

    def __init__(self, cell: Path) -> None:
        self._path = cell / RAW_FILE
        self._requests_path = cell / REQUESTS_FILE
        self._earlier_path = cell / EARLIER_FILE
        self._cell_path = cell / CELL_FILE
        self._unfinished_at: int | None = None  # where a line begins that a kill cut off
        self._stored: dict[str, Response] = {}
        self._earlier = self._read(self._earlier_path)
        # What stands in both was on its way from one file to the other when a run was killed.
        self._stored = {**self._earlier, **self._read(self._path)}
        self._answers = dict(self._stored)

    def _read(self, path: Path) -> dict[str, Response]:
        """Return a file's answers by key; an error is none unless it is the model's last word."""
        answers = {}
        for number, value in self._lines(path):
            response = with_end_read(response_from_json(value, file=str(path), line=number))
            if response.error_code in (ErrorCode.NONE, ErrorCode.DECLINED):
                answers[key_of(response.request_id)] = response
        return answers

    def _lines(self, path: Path) -> Iterator[tuple[int, Any]]:
        content = path.read_bytes() if path.exists() else b""
        lines = content.split(b"\n")
        for number, line in enumerate(lines, start=1):
            if not line.strip():
                continue
            if number == len(lines) and path == self._path and not _is_json(line):
                # A run was killed while it wrote this line; it is asked again.
                self._unfinished_at = len(content) - len(line)
                return
            yield number, parse_json_line(line, path, number)

    def find(self, key: str) -> Response | None:
        """Return the stored answer to the same question."""
        return self._answers.get(key)

    def forget(self) -> None:
        """Forget all answers, so that all is asked again; the file stays until ``finish``."""
        self._answers.clear()

    def append(self, response: Response) -> None:
        """Store a raw answer, which is on disk when this returns.

        Raises:
            HostError: the disk doesn't take it.
        """
        line = json.dumps(response_to_json(response), allow_nan=False) + "\n"
        remove_file(self._cell_path)
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
            raise not_written(self._path, error) from error

    def finish(self, exchanges: Sequence[Exchange]) -> None:
        """Leave exactly one line per answered label time, in order, and what was asked.

        Answers that were stored before and aren't among these are kept beside them, unless the same
        was asked anew.
        """
        answers = [one.response for one in exchanges if one.response is not None]
        sent = [one.request.request_id for one in exchanges if one.request is not None]
        now = {key_of(one) for one in (*sent, *(answer.request_id for answer in answers))}
        earlier = {key: answer for key, answer in self._stored.items() if key not in now}
        remove_file(self._cell_path)
        # First: an answer that stands in both files is found, one that stands in none is lost.
        if not earlier:
            remove_file(self._earlier_path)
        elif earlier != self._earlier:
            _write_lines(self._earlier_path, [response_to_json(one) for one in earlier.values()])
        _write_lines(self._path, [response_to_json(answer) for answer in answers])
        _write_lines(self._requests_path, [_question(one) for one in exchanges])


def _question(one: Exchange) -> dict[str, Any]:
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
    return {**place, **sent}


def _is_json(line: bytes) -> bool:
    try:
        json.loads(line)
    except ValueError:
        return False
    return True


def _ends_with_newline(stream: Any) -> bool:
    stream.seek(-1, os.SEEK_END)
    return bool(stream.read(1) == b"\n")


def _write_lines(path: Path, values: Sequence[dict[str, Any]]) -> None:
    lines = [json.dumps(value, allow_nan=False) for value in values]
    write_text(path, "".join(line + "\n" for line in lines))
