"""Answers that were stored before, so that parsing can be repeated without the model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ssp_core.clock import ns_to_seconds
from ssp_core.errors import InputError, PeerError
from ssp_vla_bridge.backend import check_options
from ssp_vla_bridge.messages import Answer, ErrorCode, Request, Response
from ssp_vla_bridge.stored_answers import Stored, read_stored
from ssp_vla_bridge.window import find_interface


class Recorded:
    """The stored answer with the request's id, else the one with its stamp.

    Args:
        stored: in order; of two that fit from one model in one place, the later one counts.
    """

    def __init__(self, stored: Sequence[Stored], interface: str = "waypoints") -> None:
        self.interface = interface
        self._by_id: dict[str, list[Stored]] = {}
        self._by_stamp: dict[int, list[Stored]] = {}
        for one in stored:
            if one.response.request_id:
                self._by_id.setdefault(one.response.request_id, []).append(one)
            self._by_stamp.setdefault(one.response.stamp_ns, []).append(one)
        names = sorted({one.response.model_id for one in stored})
        self.model_id = f"recorded({', '.join(names)})"

    def answer(self, request: Request) -> Answer:
        """Raises PeerError: none is stored, several differ, or an error is stored."""
        fitting = self._by_id.get(request.request_id) or self._by_stamp.get(request.stamp_ns)
        if not fitting:
            away_s = ns_to_seconds(min(abs(stamp - request.stamp_ns) for stamp in self._by_stamp))
            raise PeerError(
                "no answer is stored about the frame that is asked about; the nearest one is "
                f"about a frame {away_s:.3f} s away"
            )
        stored = _the_one(fitting, f"id {request.request_id!r}, stamp {request.stamp_ns} ns")
        if stored.error_code != ErrorCode.NONE:
            raise PeerError(f"stored error {stored.error_code}: {stored.error_msg}")
        return Answer(stored.text, stored.arrays, stored.decoding)


def _the_one(fitting: Sequence[Stored], asked: str) -> Response:
    """The answer that all places agree on; to choose among different ones would be guessing."""
    last = {(one.place, one.response.model): one for one in fitting}
    first, *others = last.values()
    for other in others:
        if _said(other.response) != _said(first.response):
            raise PeerError(
                f"different answers are stored for {asked}: of {first.response.model} in "
                f"{first.place}, of {other.response.model} in {other.place}; name the model with "
                "the option model, or one cell with file"
            )
    return first.response


def _said(response: Response) -> str:
    # repr: nan is not equal to itself, and its text is.
    return repr((response.text, response.arrays, response.error_code, dict(response.decoding)))


def make(options: Mapping[str, Any]) -> Recorded:
    """A backend for the options ``file``, ``model`` and ``interface``.

    ``file`` is JSON Lines of responses (messages.py), a cell's or a campaign's folder, or a
    bag with the answers of a shadow run; ``model`` leaves only the answers of that name.

    Raises:
        InputError: the options, the file or a line of it are wrong.
    """
    check_options("recorded", options, {"file": str, "model": str, "interface": str})
    if "file" not in options:
        raise InputError(
            "is missing",
            field="backend_options.file",
            remedy="name the raw.jsonl, the folder or the bag with the answers to repeat",
        )
    stored = read_stored(Path(options["file"]))
    if "model" in options:
        wanted = options["model"]
        names = sorted({one.response.model for one in stored})
        stored = tuple(one for one in stored if one.response.model == wanted)
        if not stored:
            raise InputError(
                f"has no answers in {options['file']}",
                field="backend_options.model",
                value=wanted,
                remedy=f"there are those of {', '.join(names)}",
            )
    return Recorded(stored, find_interface(str(options.get("interface", "waypoints"))).name)
