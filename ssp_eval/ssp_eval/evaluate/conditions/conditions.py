"""The question to a model under a condition: its own question with one thing changed."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from dataclasses import replace

from ssp_core.errors import InputError
from ssp_core.hashing import sha256_json
from ssp_eval.evaluate.clients.models import (
    BLACK,
    BLIND,
    CONDITION_SEED,
    DROPPED,
    PICTURES_CONTROL,
    REASONING,
    REPEAT,
    SHUFFLED,
    TEXT_ONLY,
    ModelSpec,
)
from ssp_eval.evaluate.conditions.corruptions import (
    corrupted_jpeg,
    encoded_again,
    is_lost,
    plain_like,
)
from ssp_eval.evaluate.store.cell_file import LabelledClip, TwinClip
from ssp_eval.recordings.clip import Clip, NoQuestion, Question
from ssp_vla_bridge.messages import Frame, Request
from ssp_vla_bridge.window import Preprocessing

_BLACK, _GREY = 0, 128


def repainted(request: Request, painted: Callable[[Frame], bytes]) -> Request:
    """Return the request with other pictures at the same stamps.

    Raises:
        InputError: a frame is no picture.
    """
    frames = tuple(Frame(frame.stamp_ns, painted(frame)) for frame in request.frames)
    return replace(request, frames=frames)


def blackened(request: Request) -> Request:
    """Return the request with black frames of the same sizes and stamps.

    Raises:
        InputError: a frame is no picture.
    """
    return repainted(request, _painter(BLACK))


def shuffled(request: Request, seed: int = CONDITION_SEED) -> Request:
    """Return the request with its pictures in another order, so that none keeps its time.

    Args:
        request: with two frames or more.
        seed: of the order, together with the request's stamp.

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


def with_other_picture(request: Request, other: Frame) -> Request:
    """Return the request with its newest picture replaced by another frame's; its stamp stays."""
    newest = replace(request.frames[-1], jpeg=other.jpeg)
    return replace(request, frames=(*request.frames[:-1], newest))


def derangement(count: int, seed: int, salt: int = 0) -> list[int]:
    """Return a random order in which nothing keeps its place: one cycle (Sattolo's algorithm).

    Args:
        count: of the things, 2 or more.
        seed: of the order.
        salt: distinguishes draws with one seed.
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
    """Return the label time whose picture is shown at another one; None where there is only one."""
    return None if len(times_s) < 2 else times_s[derangement(len(times_s), seed)[index]]


def question_under(
    labelled: LabelledClip, model: ModelSpec, label_t_s: float
) -> Question | NoQuestion:
    """Make the question to a model about a label time, under its condition."""
    clip, condition = labelled.clip, model.condition
    question = clip.question(label_t_s, model.rules)
    # What pictures are left out, or what is turned, is its backend's.
    in_backend = condition in ("", REPEAT, BLIND) or condition.startswith(REASONING)
    if in_backend or isinstance(question, NoQuestion):
        return question
    if condition in labelled.twins:
        return _about_twin(question, labelled.twins[condition], model.rules)
    another = None
    if condition == SHUFFLED and len(question.request.frames) == 1:
        times = [label.t_s for label in labelled.labels.labels]
        other_t_s = other_label_time(times, times.index(label_t_s))
        another = None if other_t_s is None else clip.question(other_t_s, model.rules)
    _, kind, strength = (*condition.split("."), "", "")[:3]
    if kind == DROPPED:
        return with_lost_frames(question, clip, int(strength))
    return under(condition, question, another)


def _about_twin(question: Question, twin: TwinClip, rules: Preprocessing) -> Question | NoQuestion:
    """Replace the recording's own question by the one about a twin."""
    twin_question = twin.clip.question(question.label_t_s, rules)
    if isinstance(twin_question, Question) and twin_question.t_s != question.t_s:
        why = (
            f"the newest frame of the twin is that at {twin_question.t_s:.3f} s, "
            f"not {question.t_s:.3f} s"
        )
        return NoQuestion(question.label_t_s, why)
    return twin_question


def with_lost_frames(question: Question, clip: Clip, strength: int) -> Question:
    """Return the question after some of the clip's frames were lost (corruptions.is_lost).

    In place of a lost frame the last one that came is shown; stamps stay, as those of a picture
    that stands still.
    """

    def lost(stamp_ns: int) -> bool:
        return is_lost(stamp_ns - clip.start_ns, strength)

    request = replace(question.request, frames=clip.last_arrived(question.request.frames, lost))
    return replace(question, request=request)


def under(
    condition: str, question: Question, another: Question | NoQuestion | None
) -> Question | NoQuestion:
    """Return a question under a condition that needs no other frames than those of questions.

    Args:
        condition: one of models.CONDITIONS or of the pictures; empty: the question itself.
        question: as it is without a condition.
        another: what would be asked at other_label_time; None where there is none. It is used
            where a request holds a single frame.
    """
    if not condition:
        return question
    if condition != SHUFFLED:
        try:
            return replace(question, request=repainted(question.request, _painter(condition)))
        except InputError as error:  # the model itself is told so; a control must end nothing
            return NoQuestion(question.label_t_s, f"there is no picture to change: {error}")
    if len(question.request.frames) > 1:
        return replace(question, request=shuffled(question.request))
    if not isinstance(another, Question):
        why = "there is no frame of another label time to show instead"
        return NoQuestion(question.label_t_s, why)
    frame = another.request.frames[-1]
    return replace(question, request=with_other_picture(question.request, frame))


def _painter(condition: str) -> Callable[[Frame], bytes]:
    """Choose the change of a frame, for a condition that changes each by itself."""
    if condition == BLACK:
        return lambda frame: plain_like(frame.jpeg, _BLACK)
    if condition == TEXT_ONLY:
        return lambda frame: plain_like(frame.jpeg, _GREY)
    if condition == PICTURES_CONTROL:
        return lambda frame: encoded_again(frame.jpeg)
    _, kind, strength = condition.split(".")
    return lambda frame: corrupted_jpeg(frame.jpeg, kind, int(strength), frame.stamp_ns)
