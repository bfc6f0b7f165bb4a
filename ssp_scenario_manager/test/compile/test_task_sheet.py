"""The sheet that the person responsible for safety signs: nothing is missing, nothing is hidden."""

from __future__ import annotations

import html
import re

import pytest

from ssp_core.cli import main
from ssp_core.names import VUT_ID
from ssp_core.run_file.model import Limits
from ssp_scenario_manager.compile.targets.task_picture import lies_on, speed_lines, top_view
from ssp_scenario_manager.compile.targets.task_sheet import limit_rows, sheet, start_row
from ssp_scenario_manager.compile.task import Task, load_task
from ssp_scenario_manager.scenarios.events.kinds import KINDS
from tests.support.events.places import site_of

EVENTS = tuple(sorted(KINDS))


@pytest.fixture(scope="module", params=EVENTS)
def task(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Task:
    out = tmp_path_factory.mktemp("sheet") / "task"
    site = site_of(request.param, "physical")
    where = ["--target", "track", "--site", site, "--out", str(out)]
    assert main(["compile", request.param, *where]) == 0
    return load_task(out)


def words_of(page: str) -> str:
    """The page's text, without marks and with single spaces."""
    body = page.partition("<body>")[2]
    return " ".join(html.unescape(re.sub(r"<[^>]+>", " ", body)).split())


def test_every_limit_stands_there_with_words_value_and_unit(task: Task) -> None:
    """``stop_reaction_s`` was missing, which the serializer leaves out at its default."""
    rows = {row.name: row for row in limit_rows(task)}
    assert list(rows) == list(Limits.model_fields)
    text = words_of(sheet(task))
    for name, row in rows.items():
        assert f"{row.words} {name} {row.value}" in text
        assert re.fullmatch(r"[a-z ]+: .+", row.words), row
        value = getattr(task.limits, name)
        if isinstance(value, float):
            assert re.match(rf"{value:g} (m/s²|m/s|m|s|rad)( \(|$)", row.value), row
    assert rows["stop_reaction_s"].value == "1 s"
    assert rows["error_yaw_rad"].value == "0.35 rad (20°)"
    assert rows["trigger_age_s"].value == f"{task.run.trigger_age_s:g} s"
    assert rows["omnidirectional"].value == "none"


def test_starts_have_heading_bearing_and_tolerance(task: Task) -> None:
    text = words_of(sheet(task))
    for spec in (task.run.vut, *task.run.targets):
        row = start_row(spec)
        assert (row.heading_deg + row.bearing_deg) % 360.0 == pytest.approx(90.0)
        assert f"{row.heading_deg:.1f} {row.bearing_deg:.1f} {row.body}" in text
    for name in Limits.model_fields:
        if name.startswith("start_"):
            row = next(r for r in limit_rows(task) if r.name == name)
            assert f"{row.words}, {row.value}" in text
    assert "under the middle of the rear axle" in text


def test_every_corner_of_the_fence_stands_there_and_is_drawn(task: Task) -> None:
    text = words_of(sheet(task))
    drawn = {label.text for label in top_view(task).labels}
    for k, (x_m, y_m) in enumerate(task.geofence, 1):
        assert f"F{k} {x_m:.2f} {y_m:.2f}" in text
        assert f"F{k}" in drawn


def test_there_is_room_to_sign(task: Task) -> None:
    assert words_of(sheet(task)).endswith("name date signature")


def test_no_label_lies_on_a_route_or_on_another(task: Task) -> None:
    view = top_view(task)
    left, top, width, height = view.box
    for number, label in enumerate(view.labels):
        assert not lies_on(label.box, view.lines), label
        a = label.box
        assert left <= a[0]
        assert a[2] <= left + width
        assert top <= a[1]
        assert a[3] <= top + height
        for other in view.labels[number + 1 :]:
            b = other.box
            assert a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] or b[3] <= a[1], (label, other)


def test_what_lies_on_a_line_is_known() -> None:
    lines = [("vut", [(0.0, 0.0), (10.0, 10.0)]), ("lane", [(0.0, 20.0), (10.0, 20.0)])]
    assert lies_on((4.0, 4.0, 6.0, 6.0), lines)
    assert lies_on((4.0, 3.0, 6.0, 20.0), lines)
    assert lies_on((10.0, 10.0, 12.0, 12.0), lines)
    assert not lies_on((6.0, 0.0, 9.0, 5.0), lines)
    assert not lies_on((11.0, 11.0, 12.0, 12.0), lines)
    assert not lies_on((1.0, 19.0, 2.0, 21.0), lines)  # borders of lanes aren't routes


def test_scale_and_north_are_true(task: Task) -> None:
    view = top_view(task)
    long_m, long_px, wide_m, wide_px = view.scale
    fence = next(outline for kind, outline in view.areas if kind == "fence")
    xs = [x for x, _ in fence]
    bends = task.run.road.pieces
    if not bends:
        # The fence of a straight lies along it: its length by the scale is that of its corners.
        sides = [
            ((ax - bx) ** 2 + (ay - by) ** 2) ** 0.5
            for (ax, ay), (bx, by) in zip(
                task.geofence, [*task.geofence[1:], task.geofence[0]], strict=True
            )
        ]
        assert (max(xs) - min(xs)) / long_px * long_m == pytest.approx(max(sides), rel=0.05)
    assert wide_px / wide_m >= long_px / long_m * (1.0 - 1e-9)
    (_, foot), (_, tip) = view.north
    # The road of this site runs to the north-east, so that north is up, to the left of it.
    assert tip < foot


def test_speeds_are_one_profile_from_start_to_standstill(task: Task) -> None:
    lines, fires_s = speed_lines(task)
    assert [line.name for line in lines] == [VUT_ID, *(t.id for t in task.run.targets)]
    standing = {target.id for target in task.run.targets if target.approach is None}
    acting = {
        t.object_id
        for t in task.run.triggers
        if t.manoeuvre.kind != "hold" or t.object_id not in standing
    }
    for line in lines:
        times = [t for t, _ in line.points]
        assert times == sorted(times)
        speeds = [v for _, v in line.points]
        assert min(speeds, default=0.0) >= 0.0
        assert max(speeds, default=0.0) <= task.limits.speed_mps
        steps = zip(line.points, line.points[1:], strict=False)
        assert all(abs(b[1] - a[1]) <= 6.0 * (b[0] - a[0]) + 0.05 for a, b in steps), line.name
        if line.name in acting:
            assert times[-1] > fires_s
            assert speeds[-1] == pytest.approx(0.0, abs=0.05)
