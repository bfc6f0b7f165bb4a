"""Answers that were recorded before: in files of responses, and in the messages of a bag."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ssp_core.bag.reader import BagReader
from ssp_core.cdr.messages import stamp_ns
from ssp_core.errors import InputError
from ssp_vla_bridge.messages import NativeArray, Response, response_from_json

RESPONSE_TYPE = "ssp_msgs/msg/VlaResponse"


def response_of_message(message: Any) -> Response:
    """The response in a decoded message (ssp_core.bag.BagReader.decode).

    Raises:
        ValueError: its decoding facts are no JSON object.
    """
    decoding = json.loads(message.decoding) if message.decoding else {}
    if not isinstance(decoding, dict):
        raise ValueError(f"decoding must be a JSON object, got {message.decoding[:100]!r}")
    return Response(
        request_id=str(message.request_id),
        stamp_ns=stamp_ns(message.header.stamp),
        model=str(message.model),
        model_id=str(message.model_id),
        text=str(message.text),
        arrays=tuple(
            NativeArray(
                name=str(one.name),
                shape=tuple(int(size) for size in one.shape),
                data=tuple(float(value) for value in one.data),
                frame=str(one.frame),
                unit=str(one.unit),
                step_s=float(one.step),
                first_time_s=float(one.first_time),
            )
            for one in message.arrays
        ),
        decoding=decoding,
        latency_s=float(message.latency),
        error_code=int(message.error_code),
        error_msg=str(message.error_msg),
    )


RAW_FILE = "raw.jsonl"
_CELLS = "cells"
_MAX_LINE_BYTES = 64 << 20
_TOPIC = re.compile(r"(?:.*/)?vla/([^/]+)/response")


@dataclass(frozen=True)
class Stored:
    """A stored answer.

    Args:
        place: the file or topic; answers of one place are in the order in which they came.
    """

    response: Response
    place: str


def read_stored(path: Path) -> tuple[Stored, ...]:
    """Every answer in a JSON Lines file, a cell's folder, a campaign's folder or a bag.

    Raises:
        InputError: it is none of these, holds no answers, or can't be read.
    """
    stored = tuple(_answers(path))
    if not stored:
        raise InputError("holds no responses", file=path)
    return stored


def _answers(path: Path) -> Iterator[Stored]:
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


def _lines(path: Path) -> Iterator[Stored]:
    try:
        with open(path, "rb") as stream:
            number = 0
            while line := stream.readline(_MAX_LINE_BYTES):
                number += 1
                if not line.strip():
                    continue
                try:
                    value = json.loads(line)
                except (ValueError, RecursionError) as error:
                    raise InputError(
                        f"is not valid JSON: {error}", file=path, line=number
                    ) from error
                response = response_from_json(value, file=str(path), line=number)
                yield Stored(response, str(path))
    except OSError as error:
        raise InputError(f"can't be read: {error.strerror}", file=path) from error


def _bag(path: Path) -> Iterator[Stored]:
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
                ) from error
            yield Stored(response, f"{path}:{message.topic}")
