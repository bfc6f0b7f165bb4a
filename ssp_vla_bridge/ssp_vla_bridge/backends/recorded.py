"""Answers that were recorded before: in files of responses, and in the messages of a bag."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ssp_core.bag.reading.reader import BagReader
from ssp_core.cdr.messages import stamp_ns
from ssp_core.clock import ns_to_seconds
from ssp_core.errors import InputError, PeerError, not_read
from ssp_core.files.strict_json import parse_json_line
from ssp_vla_bridge.backend import check_options
from ssp_vla_bridge.messages import (
    Answer,
    ErrorCode,
    NativeArray,
    Request,
    Response,
    of_message,
    response_from_json,
)
from ssp_vla_bridge.window import INTERFACES, find_interface

RESPONSE_TYPE = "ssp_msgs/msg/VlaResponse"


def response_of_message(message: Any) -> Response:
    """Return the response in a decoded message (ssp_core.bag.reading.reader.BagReader.decode).

    Raises:
        ValueError: its decoding facts are no JSON object.
    """
    decoding = json.loads(message.decoding) if message.decoding else {}
    if not isinstance(decoding, dict):
        raise ValueError(f"decoding must be a JSON object, got {message.decoding[:100]!r}")
    arrays = tuple(of_message(NativeArray, one) for one in message.arrays)
    at_ns = stamp_ns(message.header.stamp)
    return of_message(Response, message, stamp_ns=at_ns, arrays=arrays, decoding=decoding)


RAW_FILE = "raw.jsonl"
_CELLS = "cells"
_MAX_LINE_BYTES = 64 << 20
_TOPIC = re.compile(r"(?:.*/)?vla/([^/]+)/response")


@dataclass(frozen=True)
class AnswerOnDisk:
    """A stored answer.

    Args:
        place: the file or topic; answers of one place are in the order in which they came.
    """

    response: Response
    place: str


def read_stored(path: Path) -> tuple[AnswerOnDisk, ...]:
    """Read every answer in a JSON Lines file, a cell's folder, a campaign's folder or a bag.

    Raises:
        InputError: it is none of these, holds no answers, or can't be read.
    """
    stored = tuple(_answers(path))
    if not stored:
        raise InputError(
            "holds no responses", file=path, remedy="name a file or a bag with answers"
        )
    return stored


def _answers(path: Path) -> Iterator[AnswerOnDisk]:
    if path.is_file():
        yield from _bag(path) if path.suffix == ".mcap" else _lines(path)
    elif (path / RAW_FILE).is_file():
        yield from _lines(path / RAW_FILE)
    elif (path / "metadata.yaml").is_file():
        yield from _bag(path)
    elif (path / _CELLS).is_dir():
        for cell in sorted((path / _CELLS).iterdir()):
            if (cell / RAW_FILE).is_file():
                yield from _lines(cell / RAW_FILE)
    else:
        raise InputError(
            "is no place of stored answers" if path.exists() else "is not there",
            file=path,
            remedy=f"name a {RAW_FILE}, a cell's folder, a campaign's folder or a bag",
        )


def _lines(path: Path) -> Iterator[AnswerOnDisk]:
    try:
        with open(path, "rb") as stream:
            number = 0
            while line := stream.readline(_MAX_LINE_BYTES):
                number += 1
                if not line.strip():
                    continue
                value = parse_json_line(line, path, number)
                response = response_from_json(value, file=str(path), line=number)
                yield AnswerOnDisk(response, str(path))
    except OSError as error:
        raise not_read(path, error) from error


def _bag(path: Path) -> Iterator[AnswerOnDisk]:
    with BagReader(path) as reader:
        topics = [name for name, topic in reader.topics.items() if topic.msgtype == RESPONSE_TYPE]
        topics = [name for name in topics if _TOPIC.fullmatch(name)]
        for message in reader.messages(topics):
            try:
                response = response_of_message(reader.decode(message))
            except (ValueError, RecursionError, AttributeError) as error:
                raise InputError(
                    f"holds an answer at {message.log_time_ns} ns that can't be read: {error}",
                    file=path,
                    field=message.topic,
                    remedy="record the answers again",
                ) from error
            yield AnswerOnDisk(response, f"{path}:{message.topic}")


class RecordedAnswers:
    """The stored answers about a request's frame: the one with its id, else the one about it.

    Ids alone say nothing: each driven run counts its questions from 1.

    Args:
        stored: in order; of two that fit from one model in one place, the later one counts.
    """

    def __init__(self, stored: Sequence[AnswerOnDisk], interface: str = "waypoints") -> None:
        self.interface = interface
        self._by_stamp: dict[int, list[AnswerOnDisk]] = {}
        for one in stored:
            self._by_stamp.setdefault(one.response.stamp_ns, []).append(one)
        names = sorted({one.response.model_id for one in stored})
        self.model_id = f"recorded({', '.join(names)})"

    def answer(self, request: Request) -> Answer:
        """Return the stored answer; raise PeerError for none, differing ones, or an error."""
        about = self._by_stamp.get(request.stamp_ns, [])
        fitting = [one for one in about if one.response.request_id == request.request_id] or about
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


def _the_one(fitting: Sequence[AnswerOnDisk], request_text: str) -> Response:
    """Return the answer that all places agree on; raise PeerError where they differ."""
    last = {(one.place, one.response.model): one for one in fitting}
    first, *others = last.values()
    for other in others:
        if _content(other.response) != _content(first.response):
            raise PeerError(
                f"different answers are stored for {request_text}: of {first.response.model} in "
                f"{first.place}, of {other.response.model} in {other.place}; name the model with "
                "the option model, or one cell with file"
            )
    return first.response


def _content(response: Response) -> str:
    # repr: nan is not equal to itself, and its text is.
    return repr((response.text, response.arrays, response.error_code, dict(response.decoding)))


def make(options: Mapping[str, Any]) -> RecordedAnswers:
    """Make a backend for the options ``file``, ``model`` and ``interface``.

    ``file`` is JSON Lines of responses (messages.py), a cell's or a campaign's folder, or a
    bag with the answers of a shadow run; ``model`` leaves only the answers of that name.

    Raises:
        InputError: the options, the file or a line of it are wrong, or the answers were given by
            another interface, by which they would be read as something else.
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
        model = options["model"]
        names = sorted({one.response.model for one in stored})
        stored = tuple(one for one in stored if one.response.model == model)
        if not stored:
            raise InputError(
                f"has no answers in {options['file']}",
                field="backend_options.model",
                value=model,
                remedy=f"there are those of {', '.join(names)}",
            )
    spoken = find_interface(str(options.get("interface", "waypoints"))).name
    stated = [one.response.decoding.get("interface") for one in stored]
    interfaces = sorted(name for name in INTERFACES if name != spoken and name in stated)
    if interfaces:
        raise InputError(
            f"answers in {options['file']} were given by the interface {', '.join(interfaces)}",
            field="backend_options.interface",
            value=spoken,
            remedy=f'give "interface": "{interfaces[0]}", and "model" where the file has several '
            "models",
        )
    return RecordedAnswers(stored, spoken)
