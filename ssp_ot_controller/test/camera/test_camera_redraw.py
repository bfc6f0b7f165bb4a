"""Frames drawn again from recorded states, and how far an object reaches in them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Look, RunSpec
from ssp_core.vocabulary import ObjectClass
from ssp_ot_controller.camera.redraw import Picture, Redrawing
from tests.support.runs import cut_in_run
from tests.support.states import object_state

RUN = RunSpec.model_validate({**cut_in_run(), "camera": {"width_px": 240, "height_px": 135}})
VUT = object_state("vut", x_m=50.0)
# Ahead, beside and partly behind the camera, on both sides, near enough to fill the picture.
PLACES = [
    (58.0, 3.5, 0.0), (58.0, -2.5, 0.1), (53.0, 2.8, 0.0), (51.5, -2.8, 0.3), (50.0, 3.2, -0.4),
    (46.0, 3.0, 0.0), (44.0, 1.0, 1.5), (57.0, 0.0, 3.1), (90.0, 3.5, 0.0),
]  # fmt: skip


def taken(*others: ObjectState) -> tuple[Redrawing, Picture]:
    """The first frame of a world."""
    camera = Redrawing(RUN)
    scene = camera.see(0, 0, (*others, VUT))
    assert scene is not None
    return camera, camera.draw(scene, 0)


def differing(one: Picture, two: Picture) -> Any:
    return (one.pixels != two.pixels).any(axis=2)


@pytest.mark.parametrize("kind", [ObjectClass.CAR, ObjectClass.TRUCK, ObjectClass.PEDESTRIAN])
def test_an_object_changes_no_pixel_beyond_what_it_touches(kind: ObjectClass) -> None:
    _, empty = taken()
    seen = 0
    for x_m, y_m, yaw_rad in PLACES:
        camera, picture = taken(object_state("ot1", kind, x_m, y_m, yaw_rad))
        changed, touched = differing(empty, picture), camera.touched(picture.scene, "ot1")
        assert not (changed & ~touched).any(), (x_m, y_m)
        seen += int(np.count_nonzero(changed))
        # The bound is no picture-wide excuse: shadow, outline and softening are all it adds.
        assert np.count_nonzero(touched) <= 1.6 * np.count_nonzero(changed) + 500, (x_m, y_m)
    assert seen > 500


def test_what_is_not_there_touches_nothing() -> None:
    camera, picture = taken(object_state("ot1", x_m=30.0))
    assert not camera.touched(picture.scene, "ot1").any()
    assert not camera.touched(picture.scene, "ot2").any()


def test_only_steps_with_a_frame_and_a_vut_have_a_scene() -> None:
    camera = Redrawing(RUN)
    assert camera.see(0, 0, (VUT,)) is not None
    assert camera.see(1, 20_000_000, (VUT,)) is None
    assert camera.see(5, 100_000_000, (object_state("ot1"),)) is None


@pytest.mark.parametrize(
    ("look", "exposure_time_s", "bounded"),
    [
        (Look(), 0.0, True),
        (Look(light="dusk"), 0.0, False),
        (Look(rain=0.5), 0.0, False),
        (Look(), 0.01, False),
    ],
)
def test_light_that_reaches_further_is_known(
    look: Look, exposure_time_s: float, bounded: bool
) -> None:
    assert RUN.camera is not None
    camera = RUN.camera.model_copy(update={"exposure_time_s": exposure_time_s})
    run = RUN.model_copy(update={"look": look, "camera": camera})
    assert Redrawing(run).reaches_no_further is bounded
