"""Corruptions of pictures: the same bytes each time, each what its name says, 2 stronger than 1."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

from ssp_core.errors import InputError
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.clients.model_replies import ModelReply
from ssp_eval.evaluate.clients.models import (
    CORRUPTIONS,
    DROPPED,
    PICTURES,
    PICTURES_CONTROL,
    TEXT_ONLY,
    ModelSpec,
    bridge_spec,
    condition_of,
)
from ssp_eval.evaluate.conditions.conditions import under, with_lost_frames
from ssp_eval.evaluate.conditions.corruptions import (
    EFFECTS,
    Picture,
    corrupted,
    corrupted_jpeg,
    encoded_again,
    is_lost,
    plain_like,
)
from ssp_eval.evaluate.conditions.expansion import with_controls, with_pictures
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.store.results import load_cells
from ssp_eval.recordings.clip import Clip, NoQuestion, Question
from ssp_eval.report.page import write_report
from ssp_eval.statistics.rows import entering, rows_from_cells
from ssp_vla_bridge.messages import Frame, Request, Response
from tests.support.models.answering import Answering

BagMaker = Callable[..., Path]
STAMP_NS = 1_200_000_000


def street() -> Picture:
    """A sky over a road with a marking and a dark vehicle, 160 × 90 px."""
    image = np.empty((90, 160, 3), np.uint8)
    image[:45], image[45:] = (210, 190, 170), (90, 90, 90)
    image[60:85, 70:74] = (235, 235, 235)
    image[40:56, 40:60] = (60, 30, 20)
    return image


def encoded(image: Picture) -> bytes:
    done, jpeg = cv2.imencode(".jpg", image)
    assert done
    return jpeg.tobytes()


def decoded(jpeg: bytes) -> Picture:
    image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return image.astype(np.uint8)


def sharpness(image: Picture) -> float:
    """Mean square of the picture's second differences."""
    return float(np.mean(cv2.Laplacian(image.astype(np.float64), cv2.CV_64F) ** 2))


def difference(one: Picture, other: Picture) -> float:
    return float(np.mean(np.abs(one.astype(float) - other.astype(float))))


def test_every_kind_but_lost_frames_is_an_effect_on_one_picture() -> None:
    assert (*EFFECTS, DROPPED) == CORRUPTIONS
    assert len(PICTURES) == 14
    assert all(condition_of(f"mine+{name}") == ("mine", name) for name in PICTURES)


@pytest.mark.parametrize("kind", EFFECTS)
def test_a_corruption_is_repeatable_and_grows_with_its_strength(kind: str) -> None:
    image = street()
    jpeg = encoded(image)
    found = [corrupted_jpeg(jpeg, kind, strength, STAMP_NS) for strength in (1, 2)]
    corrupted_jpeg.cache_clear()
    assert found == [corrupted_jpeg(jpeg, kind, strength, STAMP_NS) for strength in (1, 2)]
    before = image.copy()
    weak, strong = (corrupted(image, kind, strength, STAMP_NS) for strength in (1, 2))
    assert np.array_equal(image, before)
    assert weak.shape == strong.shape == image.shape
    assert 0.5 < difference(image, weak) < 0.8 * difference(image, strong)


def test_each_corruption_does_what_its_name_says() -> None:
    image = street()
    seen = {(k, n): corrupted(image, k, n, STAMP_NS) for k in EFFECTS for n in (1, 2)}
    for number in (1, 2):
        noise, blur, fog, dark, glare = (seen[kind, number] for kind in EFFECTS)
        # The mean of noise is nothing, but for what full scale cuts off.
        assert abs(noise.mean() - image.mean()) < 3.0
        assert sharpness(noise) > 2 * sharpness(image)
        assert sharpness(blur) < 0.8 * sharpness(image)
        assert abs(blur.mean() - image.mean()) < 4.0
        # Of the marking far away less is left than of the road nearby.
        far, near = (slice(46, 50), slice(None)), (slice(86, 90), slice(None))
        assert difference(fog[far], image[far]) > 3 * difference(fog[near], image[near])
        assert fog.std() < image.std()
        assert dark.mean() < 0.6 * image.mean()
        assert glare.mean() > 1.1 * image.mean()
        assert glare[27, 96].min() > 240  # the sun's place
    assert seen["low_light", 2].mean() < 0.6 * seen["low_light", 1].mean()
    assert seen["fog", 2].std() < seen["fog", 1].std()
    assert sharpness(seen["blur", 2]) < sharpness(seen["blur", 1])


def test_noise_differs_from_frame_to_frame_and_fog_does_not() -> None:
    image = street()
    for kind in EFFECTS:
        again = corrupted(image, kind, 1, STAMP_NS + 1)
        same = np.array_equal(again, corrupted(image, kind, 1, STAMP_NS))
        assert same is (kind not in ("noise", "low_light"))


def test_the_smallest_picture_can_be_corrupted_and_what_is_none_is_refused() -> None:
    tiny = np.full((1, 1, 3), 100, np.uint8)
    for kind in EFFECTS:
        assert corrupted(tiny, kind, 2, 0).shape == (1, 1, 3)
        for broken in (b"", b"no jpeg"):
            with pytest.raises(InputError, match="no picture"):
                corrupted_jpeg(broken, kind, 1, 0)
    broken_question = Question(0.0, 0.0, Request("", 1, (Frame(1, b"no jpeg"),)))
    for condition in (TEXT_ONLY, PICTURES_CONTROL, "pictures.fog.2"):
        assert isinstance(under(condition, broken_question, None), NoQuestion)


def test_frames_that_show_nothing_are_grey_and_the_control_shows_the_same() -> None:
    jpeg = encoded(street())
    grey = decoded(plain_like(jpeg, 128))
    assert grey.shape == street().shape
    assert (grey.min(), grey.max()) == (128, 128)
    assert encoded_again(jpeg) != jpeg
    assert difference(decoded(encoded_again(jpeg)), decoded(jpeg)) < 2.0


def test_lost_frames_come_in_bursts_and_more_are_lost_at_strength_two() -> None:
    times_ns = range(0, 600_000_000_000, 50_000_000)
    weak, strong = ([is_lost(t_ns, n) for t_ns in times_ns] for n in (1, 2))
    assert 0.3 < np.mean(weak) < 0.5
    assert 0.65 < np.mean(strong) < 0.85
    assert not any(a and not b for a, b in zip(weak, strong, strict=True))
    for lost in (weak, strong):
        assert 0.0 < np.mean([a != b for a, b in pairwise(lost)]) < 0.15


def test_a_lost_frame_shows_the_last_that_came(make_bag: BagMaker) -> None:
    with Clip(make_bag()) as clip:
        question = clip.question(2.0)
        assert isinstance(question, Question)
        every = {
            frame.stamp_ns: frame.jpeg
            for t_s in (0.5, 1.0, 1.5, 2.0)
            if isinstance(asked := clip.question(t_s), Question)
            for frame in asked.request.frames
        }
        frames = question.request.frames
        newest_ns = frames[-1].stamp_ns
        shown = clip.last_arrived(frames, lambda stamp_ns: stamp_ns > newest_ns - 250_000_000)
        assert [frame.stamp_ns for frame in shown] == [frame.stamp_ns for frame in frames]
        came_ns = max(stamp_ns for stamp_ns in every if stamp_ns <= newest_ns - 250_000_000)
        assert shown[-1].jpeg == shown[-2].jpeg == every[came_ns]
        assert shown[0] == frames[0]
        # Where none came there is nothing else to show.
        assert clip.last_arrived(frames, lambda _: True) == frames
        for strength in (1, 2):
            asked = [clip.question(t_s) for t_s in (0.5, 1.0, 1.5, 2.0, 2.5)]
            questions = [one for one in asked if isinstance(one, Question)]
            found = [with_lost_frames(one, clip, strength) for one in questions]
            assert found == [with_lost_frames(one, clip, strength) for one in questions]
            assert found != questions


def brightness(_: int, request: Request) -> ModelReply:
    """Says how bright the newest frame is."""
    text = f"mean {decoded(request.frames[-1].jpeg).mean():.3f}"
    return ModelReply(Response(request.request_id, request.stamp_ns, "seeing", "s/1", text))


def test_a_campaign_asks_each_model_under_every_corruption(
    make_bag: BagMaker, tmp_path: Path
) -> None:
    models = with_pictures(with_controls([ModelSpec("seeing", backend="opencv_baseline")]))
    names = [model.result_name for model in models]
    assert names[:3] == ["seeing", "seeing+black", "seeing+shuffled"]
    assert names[3:17] == [f"seeing+{condition}" for condition in PICTURES]
    assert [model.control for model in models] == [False, *[True] * 20]
    client, bags = Answering(brightness), [(make_bag(), None)]
    asked = [model for model in models if not model.answerer]
    results = run_campaign(bags, asked, client, tmp_path, CellOptions(), True)
    assert {result.status for result in results} == {"ok"}
    assert client.count == 18 * 9  # each condition, and the question itself twice
    said = {cell.model: [record.text for record in cell.records] for cell in load_cells(tmp_path)}
    assert said["seeing+pictures.text_only"] == ["mean 128.000"] * 9
    for kind in EFFECTS:
        assert said[f"seeing+pictures.{kind}.1"] != said[f"seeing+pictures.{kind}.2"]
    assert {row.model for row in entering(rows_from_cells(load_cells(tmp_path)))} == {"seeing"}
    page = write_report(tmp_path).read_text()
    seeing = page.split('<section id="controls">')[1].split("</section>")[0]
    assert seeing.count("<td>seeing</td>") == 2
    again = run_campaign(bags, asked, client, tmp_path, CellOptions())
    assert sum(result.sent for result in again) == 0


def test_models_that_look_at_no_frame_are_not_shown_corrupted_ones() -> None:
    checks = [bridge_spec(name) for name in ("constant_velocity", "perfect", "silent")]
    assert with_pictures(checks) == checks
