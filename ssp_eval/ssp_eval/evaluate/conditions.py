"""Control conditions: what a model is shown is spoilt, so that only seeing can make a difference.

A model that scores as much under them isn't scored for what it sees. Everything else in a request
stays: stamps, ego history, camera, task, previous answer.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np

from ssp_core.errors import InputError
from ssp_core.hashing import sha256_json
from ssp_eval.evaluate.controls import BLACK, CONDITION_SEED
from ssp_eval.evaluate.question import NoQuestion, Question
from ssp_vla_bridge.messages import Frame, Request


def blackened(request: Request) -> Request:
    """The request with black frames of the same sizes and stamps.

    Raises:
        InputError: a frame is no picture.
    """
    frames = tuple(Frame(frame.stamp_ns, _black(*_size(frame.jpeg))) for frame in request.frames)
    return replace(request, frames=frames)


def shuffled(request: Request, seed: int = CONDITION_SEED) -> Request:
    """The request with its pictures in another order, so that none keeps its time.

    Args:
        request: with two frames or more.
        seed: the same one gives the same order.

    Raises:
        ValueError: a single frame has no order.
    """
    if len(request.frames) < 2:
        raise ValueError("a single frame can't change its place")
    order = derangement(len(request.frames), seed, request.stamp_ns)
    frames = tuple(
        Frame(frame.stamp_ns, request.frames[other].jpeg)
        for frame, other in zip(request.frames, order, strict=True)
    )
    return replace(request, frames=frames)


def shown_another(request: Request, other: Frame) -> Request:
    """The request with its newest picture replaced by that of another time; its stamp stays."""
    newest = replace(request.frames[-1], jpeg=other.jpeg)
    return replace(request, frames=(*request.frames[:-1], newest))


def derangement(count: int, seed: int, salt: int = 0) -> list[int]:
    """A random order in which nothing keeps its place: one cycle (Sattolo's algorithm).

    Args:
        count: of the things, 2 or more.
        seed: of the campaign.
        salt: tells orders of one seed apart.
    """
    rng = random.Random(sha256_json([seed, salt]))
    order = list(range(count))
    for k in range(count - 1, 0, -1):
        j = rng.randrange(k)
        order[k], order[j] = order[j], order[k]
    return order


def other_label_time(
    times_s: Sequence[float], index: int, seed: int = CONDITION_SEED
) -> float | None:
    """The label time whose picture is shown at another one; None where there is only one.

    Args:
        times_s: of all labels.
        index: of the label that is asked about.
        seed: the same one gives the same times.
    """
    return None if len(times_s) < 2 else times_s[derangement(len(times_s), seed)[index]]


def under(
    condition: str, question: Question, another: Question | NoQuestion | None
) -> Question | NoQuestion:
    """A question under a condition.

    Args:
        condition: one of controls.CONDITIONS; empty: the question itself.
        question: as it would be asked.
        another: what would be asked at other_label_time; None where there is none. It is used
            where a request holds a single frame.
    """
    if not condition:
        return question
    if condition == BLACK:
        try:
            return replace(question, request=blackened(question.request))
        except InputError as error:  # the model itself is told so; a control must end nothing
            return NoQuestion(question.label_t_s, f"there is no size to make black: {error}")
    if len(question.request.frames) > 1:
        return replace(question, request=shuffled(question.request))
    if not isinstance(another, Question):
        why = "there is no frame of another label time to show instead"
        return NoQuestion(question.label_t_s, why)
    frame = another.request.frames[-1]
    return replace(question, request=shown_another(question.request, frame))


@lru_cache(maxsize=8)
def _black(width_px: int, height_px: int) -> bytes:
    done, jpeg = cv2.imencode(".jpg", np.zeros((height_px, width_px, 3), np.uint8))
    if not done:
        raise ValueError(f"OpenCV can't encode a picture of {width_px} × {height_px} px")
    return jpeg.tobytes()


def _size(jpeg: bytes) -> tuple[int, int]:
    # Of no bytes at all OpenCV raises an error of its own.
    data = np.frombuffer(jpeg, np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) if jpeg else None
    if image is None:
        raise InputError("is no picture", field="frame")
    return image.shape[1], image.shape[0]
