"""K*'s box that starts are drawn from: each interval is drawn, or named with a reason (8.1)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from fnmatch import fnmatch
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from ssp_core.geometry import Box, Polyline, point_in_polygon, wrap_angle
from ssp_core.run_file.latency import ZERO_LATENCY
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import FollowPath, ParticipantSpec
from ssp_scenario_manager.closed_loop.campaigns import seal
from ssp_scenario_manager.closed_loop.single_run.single import Drive, driven_run
from ssp_scenario_manager.closed_loop.starts.box import draw_run_values, gap_draw
from ssp_scenario_manager.closed_loop.starts.places import Places
from ssp_scenario_manager.closed_loop.starts.start import make_start, prepared
from ssp_scenario_manager.compile.targets.folder import prepare_run
from ssp_scenario_manager.compile.task import EVENT_FILE, TASK_FOLDER, Task, load_task
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.model import Event, Interval
from ssp_scenario_manager.scenarios.events.kinds import KINDS
from tests.support.events.places import site_of

LINE, KERB = (f"constraints.manoeuvre.{name}_distance" for name in ("line", "kerb"))
SPEED = "triggers.0.manoeuvre.motion.cruise_mps"
EVENTS = sorted(KINDS)
SEEDS = range(1, 41)
# Of a start of vut_turn in which a VUT without a response passes second.
IN_ORDER = 3
AT_JUNCTIONS = ("crossing_car", "merge", "oncoming_turn", "roundabout", "vut_turn")
# Intervals of K* that no value of a start is drawn from, and why.
NOT_DRAWN = {
    "constraints.speeds.*.trigger": "follows from the approach, which is drawn",
    "constraints.speeds.*.conflict": "follows from approach and manoeuvre, which are drawn",
    "constraints.speeds.*.resolution": "follows from approach and manoeuvre, which are drawn",
    "constraints.manoeuvre.critical_gap": "of the built-in driver, which leads no VUT to a start",
    "constraints.time_gap": "asked of the twin, as an outcome of the start",
    "constraints.camera.*": "asked of the place's camera",
    "constraints.site.*": "asked of the place",
    "constraints.safety.*": "limits that the run keeps to",
}


@pytest.fixture(scope="module")
def folder_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Gives the folder of a compiled event's task."""

    @cache
    def make(name: str) -> Path:
        folder = tmp_path_factory.mktemp("box") / name
        prepare_run(name, site_of(name), folder, seed=1, mode="lockstep")
        return folder / TASK_FOLDER

    return make


@pytest.fixture(scope="module")
def task_of(folder_of: Callable[[str], Path]) -> Callable[[str], Task]:
    return cache(lambda name: load_task(folder_of(name)))


def intervals(event: Event) -> Iterator[tuple[str, Interval]]:
    """All intervals of parts A and C that leave a choice, by field."""

    def below(value: object, path: str) -> Iterator[tuple[str, Interval]]:
        if isinstance(value, Interval):
            if value.min != value.max:
                yield path, value
        elif isinstance(value, dict):
            for key, part in value.items():
                yield from below(part, f"{path}.{key}")
        elif hasattr(value, "model_fields_set"):
            for key in type(value).model_fields:  # type: ignore[attr-defined]
                yield from below(getattr(value, key), f"{path}.{key}")

    yield from below(event.participants, "participants")
    yield from below(event.constraints, "constraints")


def with_interval(event: Event, field: str, value: dict[str, Any]) -> Event:
    data = event.model_dump(mode="json", by_alias=True)
    holder = data
    *way, last = field.split(".")
    for key in way:
        holder = holder[key]
    holder[last] = value
    return Event.model_validate(data)


def begun(task: Task, event: Event, seed: int) -> tuple[RunSpec, dict[str, float]]:
    """The run of a seed with all that is drawn of it, and a long run-up."""
    drawn, values = draw_run_values(prepared(task.run), event, seed, task.tunings_of(task.run))
    gaps = gap_draw(drawn, event, seed)
    if gaps.bounds_m is not None:
        drawn, lengths = gaps.with_gap(gaps.draw_m(1000.0))
        values |= lengths
    return drawn, values


def unused_intervals(task: Task, event: Event, among: Iterable[str]) -> set[str]:
    """Return those of some intervals of an event whose ends are nothing to its starts."""
    spans, found = dict(intervals(event)), set()
    as_it_is = {seed: begun(task, event, seed) for seed in (1, 2)}
    for field in among:
        span = spans[field]
        end = span.min if span.min is not None else span.max
        fixed = with_interval(event, field, {"min": end, "max": end, "unit": span.unit})
        if all(begun(task, fixed, seed) == start for seed, start in as_it_is.items()):
            found.add(field)
    return found


@pytest.mark.parametrize("name", EVENTS)
def test_each_interval_is_drawn_or_named_with_a_reason(
    task_of: Callable[[str], Task], name: str
) -> None:
    event = load_event(name)[0]
    left = unused_intervals(task_of(name), event, [field for field, _ in intervals(event)])
    named = {
        field
        for field, _ in intervals(event)
        if any(fnmatch(field, pattern) for pattern in NOT_DRAWN)
    }
    assert left == named
    # A quantity that no draw knows of is found.
    span = {"min": 1, "max": 2, "unit": "s"}
    pause = "constraints.manoeuvre.pause"
    more = with_interval(event, pause, span)
    assert unused_intervals(task_of(name), more, [pause]) == {pause}


def test_each_reason_is_that_of_an_interval() -> None:
    fields = [field for name in EVENTS for field, _ in intervals(load_event(name)[0])]
    for pattern in NOT_DRAWN:
        assert any(fnmatch(field, pattern) for field in fields), pattern


@pytest.mark.parametrize("name", EVENTS)
def test_who_is_ahead_begins_at_a_gap_of_ks_box(task_of: Callable[[str], Task], name: str) -> None:
    """So does who drives between the VUT and an initiator that stands."""
    task, event = task_of(name), load_event(name)[0]
    for seed in SEEDS:
        run, values = begun(task, event, seed)
        for target in run.targets:
            span = event.participants[target.id].region.gap
            assert isinstance(span, Interval)
            gap_m = Places(run).gap_m(target)
            assert span.si.low - 0.002 <= gap_m <= span.si.high + 0.002
            assert values[f"participants.{target.id}.region.gap"] == pytest.approx(gap_m, abs=1e-3)


def initiator(run: RunSpec) -> tuple[ParticipantSpec, list[tuple[float, float]]]:
    """The initiator and its way."""
    (trigger,) = run.triggers
    assert isinstance(trigger.manoeuvre, FollowPath)
    (one,) = (target for target in run.targets if target.id == run.initiator_id)
    return one, list(trigger.manoeuvre.motion.path)


@pytest.mark.parametrize("name", AT_JUNCTIONS)
def test_who_waits_before_a_junction_stands_at_a_drawn_distance_to_its_line(
    task_of: Callable[[str], Task], name: str
) -> None:
    """It moves along its lane by what the distance differs from the compiled one."""
    task, event = task_of(name), load_event(name)[0]
    tunings = task.tunings_of(task.run)
    span = event.constraints.manoeuvre["line_distance"]
    assert isinstance(span, Interval)
    before, way = initiator(task.run)
    line, found = Polyline(way), []
    for seed in SEEDS:
        run, values = draw_run_values(prepared(task.run), event, seed, tunings)
        one, path = initiator(run)
        assert span.si.low <= values[LINE] <= span.si.high
        station_m, beside_m = line.project_beyond(one.start.x_m, one.start.y_m)
        assert station_m == pytest.approx(tunings[LINE].value - values[LINE], abs=0.02)
        assert beside_m == pytest.approx(0.0, abs=0.01)
        turned_rad = wrap_angle(one.start.yaw_rad - before.start.yaw_rad)
        assert abs(turned_rad) < 0.02
        # The way begins where it stands, ahead of it, and is the same from the junction on.
        assert path[0] == (one.start.x_m, one.start.y_m)
        led = Polyline(path)
        assert abs(wrap_angle(led.pose(0.0).yaw_rad - one.start.yaw_rad)) < 0.02
        assert led.length_m == pytest.approx(line.length_m - station_m, abs=0.01)
        assert path[-1] == way[-1]
        assert set(path[3:]) <= {*way} or len(way) == 2
        assert min(math.dist(a, b) for a, b in pairwise(path)) > 0.02
        found.append(values[LINE])
    width = span.si.high - span.si.low
    assert min(found) < span.si.low + 0.2 * width
    assert max(found) > span.si.high - 0.2 * width


@pytest.mark.parametrize("name", ["vru_crossing", "occluded_crossing"])
def test_who_crosses_stands_at_a_drawn_distance_to_the_kerb(
    task_of: Callable[[str], Task], name: str
) -> None:
    task, event = task_of(name), load_event(name)[0]
    tunings = task.tunings_of(task.run)
    before, way = initiator(task.run)
    found = []
    for seed in SEEDS:
        run, values = draw_run_values(prepared(task.run), event, seed, tunings)
        one, path = initiator(run)
        # Both sites drive along x, and it comes from the right.
        further_m = values[KERB] - tunings[KERB].value
        assert (one.start.x_m, one.start.y_m) == (
            pytest.approx(before.start.x_m),
            pytest.approx(before.start.y_m - further_m),
        )
        assert one.start.yaw_rad == before.start.yaw_rad
        assert path == [(one.start.x_m, one.start.y_m), way[-1]]
        found.append(values[KERB])
    assert 0.5 <= min(found) < 0.6
    assert 0.9 < max(found) <= 1.0


def test_a_distance_is_drawn_from_what_the_fence_leaves(task_of: Callable[[str], Task]) -> None:
    """The fence leaves a metre free behind the vehicle, where K* would have three."""
    task, event = task_of("vut_turn"), load_event("vut_turn")[0]
    one, _ = initiator(task.run)
    rear_x = one.start.pose.to_parent(-one.size.rear_m - 1.0, 0.0)[0]
    assert one.start.x_m < rear_x
    fence = [(min(x, rear_x), y) for x, y in task.run.geofence]
    tight = task.run.model_copy(update={"geofence": fence})
    tunings = task.tunings_of(tight)
    values, free = [], []
    for seed in SEEDS:
        drawn, found = draw_run_values(prepared(tight), event, seed, tunings)
        stands = initiator(drawn)[0]
        box = Box(stands.start.pose, stands.size.front_m, stands.size.rear_m, stands.size.width_m)
        assert all(point_in_polygon(*corner, fence) for corner in box.corners())
        values.append(found[LINE])
        free.append(draw_run_values(prepared(task.run), event, seed, tunings)[1][LINE])
    assert 6.8 < max(values) <= 7.0
    assert max(free) > 8.0


def test_a_vehicle_over_a_junction_is_as_fast_as_road_and_bend_allow(
    task_of: Callable[[str], Task],
) -> None:
    for name, quantity in (("crossing_car", "crossing"), ("roundabout", "circulating")):
        task, event = task_of(name), load_event(name)[0]
        tunings = task.tunings_of(task.run)
        span = event.constraints.manoeuvre[f"{quantity}_speed"]
        most = tunings[f"constraints.manoeuvre.{quantity}_speed"].at_most
        assert isinstance(span, Interval)
        assert most is not None
        assert span.si.low < most < span.si.high
        found = [draw_run_values(task.run, event, seed, tunings)[1][SPEED] for seed in SEEDS]
        assert span.si.low <= min(found) < max(found) <= most


def test_what_the_compiler_knew_alone_stays_as_compiled_without_its_task(
    task_of: Callable[[str], Task],
) -> None:
    """The quantities drawn without the task keep their values with it."""
    task, event = task_of("oncoming_turn"), load_event("oncoming_turn")[0]
    with_task = draw_run_values(task.run, event, 3, task.tunings_of(task.run))[1]
    without = draw_run_values(task.run, event, 3)[1]
    assert with_task.keys() - without.keys() == {SPEED}
    assert without.items() <= with_task.items()
    walks, event = task_of("vru_crossing"), load_event("vru_crossing")[0]
    assert KERB not in draw_run_values(walks.run, event, 3)[1]


def test_a_task_says_nothing_of_objects_that_were_moved_since(
    task_of: Callable[[str], Task],
) -> None:
    task = task_of("vru_crossing")
    assert task.tunings_of(task.run)[KERB].value == pytest.approx(0.75)
    (walker,) = task.run.targets
    start = walker.start.model_copy(update={"y_m": walker.start.y_m + 0.1})
    moved = [walker.model_copy(update={"start": start})]
    assert not task.tunings_of(task.run.model_copy(update={"targets": moved}))


def test_the_critical_gap_is_nothing_to_a_start(task_of: Callable[[str], Task]) -> None:
    """It is the built-in driver's: neither the run-up nor the twin has it."""
    task, event = task_of("vut_turn"), load_event("vut_turn")[0]
    facts = []
    for gap_s in (3.6, 4.6):
        (place,) = task.run.driver.gives_way
        driver = task.run.driver.model_copy(
            update={"gives_way": [place.model_copy(update={"critical_gap_s": gap_s})]}
        )
        run = task.run.model_copy(update={"driver": driver})
        start = make_start(run, event, IN_ORDER, 0.5, tunings=task.tunings_of(run))
        facts.append((start.facts(), start.twin, start.run.targets))
    assert facts[0] == facts[1]


def test_one_run_and_a_campaign_draw_by_the_task(
    folder_of: Callable[[str], Path], task_of: Callable[[str], Task]
) -> None:
    task, event_file = task_of("vru_crossing"), folder_of("vru_crossing") / EVENT_FILE
    run = task.run.model_copy(update={"seed": 2})
    driven = driven_run(run, event_file, Drive("oracle", {}, ZERO_LATENCY), lambda _: None)
    compiled, one = (each.targets[0].start.y_m for each in (run, driven))
    assert compiled != one
    kind, facts = seal._draw_facts(
        run.model_dump_json(by_alias=True), str(event_file), (0.0, 0.0), 2
    )
    assert kind in seal.KINDS
    assert facts["values"][KERB] == pytest.approx(0.75 + compiled - one, abs=1e-6)
