"""The reports of a probed object while it drives, judged as a session judges them."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from copy import copy
from dataclasses import replace
from functools import cache
from typing import Any, get_args

import numpy as np
import pytest

from ssp_core.geometry import wrap_angle
from ssp_core.run_file.model import Limits
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.safety.consistency import Bounds
from ssp_core.vocabulary import ObjectClass, ObjectWord
from ssp_ot_controller.bodies.iso22133.conversation import NewestReport
from ssp_ot_controller.bodies.iso22133.gateway import ProbeGate
from ssp_ot_controller.bodies.iso22133.messages import (
    DecodedMessage,
    DriveDirection,
    Monr,
    ObjectError,
)
from ssp_ot_controller.bodies.iso22133.probe.stages import Probe, report_of
from ssp_ot_controller.bodies.iso22133.probe_report import (
    ObjectKind,
    Outcome,
    ProbeReport,
    cannot_arm,
)
from tests.support.iso22133.centre import HOST, T0, S
from tests.support.iso22133.probed import STAGES, Probed, ReorderingLink, with_verdict

LIMITS = Limits(speed_mps=20.0, acceleration_mps2=4.0)
DRIVES = ("normal_stop", "abort", "loss")
Change = Callable[[Monr], Monr]


CAR = ObjectKind(ObjectClass.CAR)


def arming_problems(report: ProbeReport, kind: ObjectKind = CAR) -> str:
    return " ".join(cannot_arm(report, LIMITS, report.firmware, None, kind))


def set_to(**fields: Any) -> Change:
    return lambda monr: replace(monr, **fields)


def shifted(seconds: float) -> Change:
    def change(monr: Monr) -> Monr:
        assert monr.time_of_week_ns is not None
        return replace(monr, time_of_week_ns=monr.time_of_week_ns + round(seconds * S))

    return change


def turned(degrees: float) -> Change:
    def change(monr: Monr) -> Monr:
        assert monr.yaw_rad is not None
        return replace(monr, yaw_rad=wrap_angle(monr.yaw_rad + math.radians(degrees)))

    return change


def only_in(drive: str, change: Change) -> Callable[[str, Monr], Monr]:
    return lambda step, monr: change(monr) if step == drive else monr


@cache
def sound() -> Probe:
    """A probe of a sound object, which has ended."""
    probed = Probed()
    probed.run()
    return probed.probe


@cache
def omnidirectional() -> ProbeReport:
    return Probed(omnidirectional=True).run()


def report_with(drive: str, change: Change) -> ProbeReport:
    """Judge the sound probe as if other reports had come in one of its drives."""
    probe = copy(sound())
    step = probe.steps[drive]
    came = [
        replace(one, outcome=replace(one.outcome, message=change(one.outcome.message)))
        if isinstance(one.outcome, DecodedMessage) and isinstance(one.outcome.message, Monr)
        else one
        for one in step.came
    ]
    probe.steps = {**probe.steps, drive: replace(step, came=came)}
    return report_of(probe, HOST, 53241, T0, STAGES)


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize(
    ("change", "clause", "words"),
    [
        (set_to(drive_direction=DriveDirection.BACKWARD), "move.motion", "yaw turned by 180°"),
        (turned(180.0), "move.motion", "yaw turned by 180°"),
        (turned(30.0), "move.motion", "yaw contradicts the way"),
        (set_to(speed_mps=0.0), "move.motion", "empty twist"),
        (set_to(time_of_week_ns=None), "move.age", "time_of_week_ns unavailable"),
        (set_to(speed_mps=None), "move.age", "speed_mps unavailable"),
        (shifted(-100.0), "move.age", "its clock is behind"),
        (shifted(100.0), "move.clock", "its clock is ahead"),
        (shifted(0.2), "move.clock", "its clock is ahead"),
        (
            set_to(error_status=int(ObjectError.BAD_POSITIONING_ACCURACY)),
            "move.position",
            "bad positioning",
        ),
    ],
)
def test_what_would_end_a_session_is_judged_in_each_drive_and_keeps_it_from_being_armed(
    drive: str, change: Change, clause: str, words: str
) -> None:
    report = report_with(drive, change)
    row = report.row(clause)
    assert row is not None
    assert row.verdict is Outcome.FAIL
    assert words in row.text
    assert row.came
    assert f"({clause})" in arming_problems(report)


@pytest.mark.parametrize(
    ("change", "clause"),
    [
        (set_to(drive_direction=DriveDirection.BACKWARD), "move.motion"),
        (set_to(time_of_week_ns=None), "move.age"),
        (set_to(speed_mps=None), "move.age"),
        (shifted(0.2), "move.clock"),
    ],
)
def test_a_probe_during_which_an_object_reports_so_ends_and_tells_it(
    change: Change, clause: str
) -> None:
    report = Probed(reports=while_driving(change)).run()
    assert clause in with_verdict(report, Outcome.FAIL)
    assert f"({clause})" in arming_problems(report)


def test_an_object_that_drives_backwards_contradicts_its_trajectory() -> None:
    def reversing(monr: Monr) -> Monr:
        return replace(turned(180.0)(monr), drive_direction=DriveDirection.BACKWARD)

    report = Probed(reports=while_driving(reversing)).run()
    row = report.row("move.motion")
    assert row is not None
    assert row.text.startswith("drives backwards: yaw turned by 180°")
    assert "(move.motion)" in arming_problems(report)


def test_without_a_heading_the_probe_goes_no_further() -> None:
    report = Probed(reports=only_in("abort", set_to(yaw_rad=None))).run()
    assert with_verdict(report, Outcome.NOT_RUN) >= {"move.abort", "move.heartbeat_loss"}
    assert "(move.abort)" in arming_problems(report)


@pytest.mark.parametrize("drive", DRIVES[1:])
def test_a_way_beside_the_trajectory_is_judged_in_each_drive(drive: str) -> None:
    def beside(monr: Monr) -> Monr:
        assert monr.y_m is not None
        return replace(monr, y_m=monr.y_m + 1.5) if monr.state == 4 else monr

    report = Probed(reports=only_in(drive, beside)).run()
    assert "move.way" in with_verdict(report, Outcome.FAIL)


# -- sound objects --------------------------------------------------------------------------------


def while_driving(change: Change) -> Callable[[str, Monr], Monr]:
    return lambda step, monr: change(monr) if step in DRIVES else monr


@pytest.mark.parametrize(
    ("object_class", "degrees"),
    [
        ("car", 15.0),
        ("truck", -15.0),
        ("motorcycle", 15.0),
        ("cyclist", 25.0),
        ("pedestrian", 50.0),
    ],
)
def test_a_sound_object_of_each_class_passes(object_class: str, degrees: float) -> None:
    report = Probed(
        object_class=object_class, reports=while_driving(turned(degrees)), link=ReorderingLink
    ).run()
    assert with_verdict(report, Outcome.FAIL) == {"listen.counter"}
    assert arming_problems(report, report.kind) == ""


@pytest.mark.parametrize(
    ("object_class", "change"),
    [
        ("pedestrian", turned(180.0)),
        ("pedestrian", set_to(drive_direction=DriveDirection.BACKWARD)),
    ],
)
def test_a_person_may_go_either_way(object_class: str, change: Change) -> None:
    report = Probed(object_class=object_class, reports=while_driving(change)).run()
    assert with_verdict(report, Outcome.FAIL) == set()


@pytest.mark.parametrize("delay_s", [-0.2, 0.2])
def test_a_constant_delay_between_place_and_speed_is_sound(delay_s: float) -> None:
    kept: deque[Monr] = deque(maxlen=1 + round(abs(delay_s) * 100))

    def delayed(_: str, monr: Monr) -> Monr:
        kept.append(monr)
        old = kept[0]
        if delay_s > 0.0:
            return replace(monr, speed_mps=old.speed_mps)
        return replace(old, speed_mps=monr.speed_mps, time_of_week_ns=monr.time_of_week_ns)

    assert "move.motion" in with_verdict(Probed(reports=delayed).run(), Outcome.PASS)


def test_a_heading_that_is_known_in_motion_alone_is_sound() -> None:
    """A source with one antenna states its last course, or any, while it stands."""

    def by_course(step: str, monr: Monr) -> Monr:
        assert monr.speed_mps is not None
        stands = step in DRIVES and monr.speed_mps < 0.5
        return turned(120.0)(monr) if stands else monr

    assert with_verdict(Probed(reports=by_course).run(), Outcome.FAIL) == set()


@pytest.mark.parametrize("degrees", [90.0, -130.0])
def test_of_what_moves_in_any_direction_the_speed_alone_counts(degrees: float) -> None:
    report = Probed(omnidirectional=True, reports=while_driving(turned(degrees))).run()
    assert with_verdict(report, Outcome.FAIL) == set()
    assert arming_problems(report, report.kind) == ""


def test_what_moves_in_any_direction_and_states_another_speed_is_not_armed() -> None:
    wrong = Probed("speed_factor=0.28", omnidirectional=True).run()
    assert "(move.motion)" in arming_problems(wrong, wrong.kind)


def test_a_report_of_a_kind_with_wider_bounds_arms_no_other() -> None:
    report = omnidirectional()
    assert arming_problems(report) == (
        "its probe report judges its motion by `--class car --omnidirectional`: probe it with "
        "`--class car`"
    )
    kinds = {word: ObjectKind(ObjectClass.from_word(word)) for word in ("car", "bus", "cyclist")}
    assert not kinds["car"].is_laxer(kinds["bus"])
    assert not kinds["car"].is_laxer(kinds["cyclist"])
    assert kinds["cyclist"].is_laxer(kinds["car"])
    person = ObjectKind(ObjectClass.PEDESTRIAN)
    assert person.is_laxer(kinds["cyclist"])
    assert not person.is_laxer(ObjectKind(ObjectClass.CAR, omnidirectional=True))


@pytest.mark.parametrize("word", get_args(ObjectWord))
@pytest.mark.parametrize("names", [[], ["ot1"]])
def test_a_kind_has_the_bounds_of_the_session_and_its_gate_asks_for_them(
    word: str, names: list[str]
) -> None:
    start = {"x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0}
    spec = ParticipantSpec.model_validate({"id": "ot1", "object_class": word, "start": start})
    limits = LIMITS.model_copy(update={"omnidirectional": names})
    kind, session = ObjectKind.of(spec, limits), Bounds.of("ot1", spec.cls, limits)
    assert (kind.bounds.direction_rad, kind.bounds.signed) == (
        session.direction_rad,
        session.signed,
    )
    report = omnidirectional()
    gate = " ".join(ProbeGate(report, limits, "", kind).judge(NewestReport()).gate)
    assert ("probe it with `--class" in gate) is (not names)


def test_noise_of_a_sound_receiver_is_sound() -> None:
    draw = np.random.default_rng(26).normal

    def noisy(monr: Monr) -> Monr:
        assert monr.x_m is not None
        assert monr.y_m is not None
        assert monr.yaw_rad is not None
        assert monr.speed_mps is not None
        return replace(
            monr,
            x_m=monr.x_m + draw(0.0, 0.005),
            y_m=monr.y_m + draw(0.0, 0.005),
            yaw_rad=wrap_angle(monr.yaw_rad + draw(0.0, 0.02)),
            speed_mps=monr.speed_mps + draw(0.0, 0.05),
        )

    report = Probed(reports=while_driving(noisy)).run()
    assert "move.motion" in with_verdict(report, Outcome.PASS)
