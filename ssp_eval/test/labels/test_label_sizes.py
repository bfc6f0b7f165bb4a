"""The size of the critical object at each label, in the audit and in the table of labels."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from evaluation_files import audit_file

from ssp_core.run_file.model import Camera
from ssp_core.vocabulary import ObjectClass
from ssp_core.world.camera import Mounting, intrinsics
from ssp_eval.audit.cli import show
from ssp_eval.audit.evidence.visibility import label_sizes
from ssp_eval.audit.page import PagePictures, render
from ssp_eval.data.audit import LabelCount, LabelSize, load_audit
from ssp_eval.data.labels import Label, Labels
from ssp_eval.recordings.sight import Moment, Optics, object_height_px
from ssp_eval.statistics.table import by_column
from ssp_eval.statistics.tables.labels import HARDLY_VISIBLE, label_table
from tests.support.states import object_state as box

CAMERA = Camera()
OPTICS = Optics(
    intrinsics(CAMERA), Mounting(CAMERA.forward_m, CAMERA.height_m, CAMERA.pitch_down_rad)
)
VUT = box("vut", ObjectClass.CAR, 0.0, 0.0)
VIEW = OPTICS.view(VUT.pose)
LABELS = Labels(
    "cut_in",
    "physical",
    "v",
    0.0,
    False,
    tuple(
        Label(t_s, "approach", True, ("pedestrian",), "front", None, None, ("stop",), ("straight",))
        for t_s in (0.5, 1.0, 1.5)
    ),
)


def test_the_height_falls_with_the_distance_and_is_that_of_a_pinhole() -> None:
    walker = box("ot1", ObjectClass.PEDESTRIAN, 40.0, 0.0)
    away_m = 40.0 - CAMERA.forward_m
    by_hand = OPTICS.lens.fy_px * walker.size.height_m / away_m
    assert object_height_px(VIEW, walker, []) == pytest.approx(by_hand, rel=0.05)
    assert object_height_px(VIEW, replace(walker, x_m=80.0), []) < by_hand / 1.9


def test_what_is_beside_the_picture_or_hidden_has_no_height() -> None:
    walker = box("ot1", ObjectClass.PEDESTRIAN, 30.0, 0.0)
    assert object_height_px(VIEW, replace(walker, x_m=-30.0), []) == 0.0
    assert object_height_px(VIEW, replace(walker, y_m=90.0), []) == 0.0
    assert object_height_px(VIEW, walker, [box("ot2", ObjectClass.TRUCK, 12.0, 0.0)]) == 0.0


def subject(**others: Any) -> Any:
    """A recording with a frame each 0.1 s, in which a walker stands ever nearer."""
    moments = [
        Moment(0.1 * k, {"vut": VUT, "ot1": box("ot1", ObjectClass.PEDESTRIAN, 200.0 / (k + 1), 0)})
        for k in range(13)
    ]
    recording = {
        "labels": LABELS,
        "optics": OPTICS,
        "provenance": SimpleNamespace(
            participants=SimpleNamespace(vut="vut"), camera=others.pop("camera", "measured")
        ),
        "moments": lambda: moments,
    }
    measured = {"initiator": "ot1", "affected": "vut"}
    return SimpleNamespace(
        whole=SimpleNamespace(**{**recording, **others}), measured=SimpleNamespace(**measured)
    )


def test_each_label_has_the_size_in_the_newest_frame_that_it_can_have_seen() -> None:
    sizes, whose = label_sizes(subject())
    assert "ot1" in whose
    at = [
        object_height_px(VIEW, box("ot1", ObjectClass.PEDESTRIAN, 200.0 / (k + 1), 0), [])
        for k in (5, 10, 12)
    ]
    assert [one.height_px for one in sizes] == pytest.approx(at)
    assert [one.t_s for one in sizes] == [0.5, 1.0, 1.5]


@pytest.mark.parametrize(
    ("others", "why"),
    [
        ({"optics": None}, "the camera's geometry is not recorded"),
        ({"camera": "assumed"}, "the camera's geometry is a guess"),
    ],
)
def test_without_a_camera_the_size_is_not_known_and_said_so(
    others: dict[str, Any], why: str
) -> None:
    sizes, told = label_sizes(subject(**others))
    assert [one.height_px for one in sizes] == [None] * 3
    assert told == f"not known: {why}"
    assert not any(one.hardly_visible for one in sizes)


def cell(bag: str) -> Any:
    facts = SimpleNamespace(hashes={"bag": bag})
    return SimpleNamespace(
        scenario="cut_in", domain="physical", score=object(), labels=LABELS, facts=facts
    )


def counted(*heights: float | None, why: str = "box of ot1") -> LabelCount:
    sizes = [
        LabelSize(t_s=label.t_s, phase="approach", height_px=height)
        for label, height in zip(LABELS.labels, heights, strict=True)
    ]
    return LabelCount(plan="clock", per_phase={}, sizes=sizes, sizes_from=why)


def table(labels: LabelCount | None) -> tuple[list[Any], str]:
    entry = SimpleNamespace(bag_sha256="sha256:1", labels=labels)
    audit: Any = SimpleNamespace(recordings=[entry])
    found = label_table([cell("sha256:1"), cell("sha256:1")], [audit])
    return by_column(found), " ".join(found.notes)


def test_a_label_under_12_px_is_marked_hardly_visible() -> None:
    rows, notes = table(counted(11.9, 12.0, None))
    assert [row["visibility"] for row in rows] == [HARDLY_VISIBLE, "", ""]
    assert [row["height_px"] for row in rows] == [11.9, 12.0, None]
    assert "Heights not known" not in notes
    assert counted(11.9, 12.0, 0.0).hardly_visible_s == [0.5, 1.5]


def test_the_audit_s_page_and_command_name_what_is_hardly_visible(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    audit = load_audit(audit_file(tmp_path / "audit.json", "admitted", "sha256:1"))
    at = next(i for i, one in enumerate(audit.recordings) if one.domain == "simulation")
    seen = audit.recordings[at].model_copy(update={"labels": counted(11.9, 12.0, None)})
    recordings = [*audit.recordings[:at], seen, *audit.recordings[at + 1 :]]
    audit = audit.model_copy(update={"recordings": recordings})
    nothing = {one.domain: [] for one in recordings}
    page = render(audit, PagePictures(nothing, dict.fromkeys(nothing)))
    assert page.count("hardly visible") == 1
    assert "0.50 s, approach: 12 px <b>hardly visible</b>" in page
    assert "1.00 s, approach: 12 px<br>" in page
    show(audit)
    told = " ".join("".join(capsys.readouterr()).split())
    assert "simulation: hardly visible, the critical object is under 12 px high" in told
    assert "at the labels of 0.50 s" in told


def test_where_nobody_knows_the_size_the_cell_is_empty_and_the_table_says_why() -> None:
    rows, notes = table(counted(None, None, None, why="not known: there are no states"))
    assert [row["height_px"] for row in rows] == [None] * 3
    assert "Heights not known: cut_in / physical (there are no states)." in notes
    rows, notes = table(None)
    assert len(rows) == 3
    assert "cut_in / physical (not in its audit)" in notes
