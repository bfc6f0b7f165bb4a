"""Answers that were stored before, so that parsing can be repeated without the model."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from ssp_core.errors import InputError, PeerError
from ssp_core.files import read_text
from ssp_vla_bridge.core.backend import check_options
from ssp_vla_bridge.core.request import Request
from ssp_vla_bridge.core.response import Answer, ErrorCode, Response, response_from_json


class Recorded:
    """The stored response with the request's id, else the one with its stamp.

    Args:
        responses: in the order of the file; of two that fit, the later one is the answer.
    """

    def __init__(self, responses: tuple[Response, ...]) -> None:
        self._by_id = {r.request_id: r for r in responses if r.request_id}
        self._by_stamp = {r.stamp_ns: r for r in responses}
        names = sorted({response.model_id for response in responses})
        self.model_id = f"recorded({', '.join(names)})"

    def answer(self, request: Request) -> Answer:
        """Raises PeerError: nothing is stored for this request, or an error is."""
        stored = self._by_id.get(request.request_id) or self._by_stamp.get(request.stamp_ns)
        if stored is None:
            raise PeerError(
                f"no answer is stored for id {request.request_id!r} or stamp {request.stamp_ns} ns"
            )
        if stored.error_code != ErrorCode.NONE:
            raise PeerError(f"stored error {stored.error_code}: {stored.error_msg}")
        return Answer(stored.text, stored.arrays, stored.decoding)


def make(options: Mapping[str, Any]) -> Recorded:
    """A backend for the option ``file``: JSON Lines of responses (core/response.py).

    Raises:
        InputError: the options, the file or a line of it are wrong.
    """
    check_options("recorded", options, {"file": str})
    if "file" not in options:
        raise InputError(
            "is missing",
            field="backend_options.file",
            remedy="name the raw.jsonl of the answers to repeat",
        )
    path = str(options["file"])
    responses = []
    for number, line in enumerate(read_text(path).split("\n"), start=1):
        if not line.strip():
            continue
        try:
            value = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise InputError(f"is not valid JSON: {error}", file=path, line=number) from error
        responses.append(response_from_json(value, file=path, line=number))
    if not responses:
        raise InputError("holds no responses", file=path)
    return Recorded(tuple(responses))
