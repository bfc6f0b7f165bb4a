"""Answerers of known cause, and their cells: factual ones and those of twins."""

from __future__ import annotations

import itertools
import json
import random
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ssp_eval.data.labels import Label, Labels
from ssp_eval.data.records import BehaviourRecord, Slot, Slots
from ssp_eval.evaluate.clients.models import ModelSpec
from ssp_eval.evaluate.conditions.design import stages_of
from ssp_eval.evaluate.store.requests import request_to_json
from ssp_eval.evaluate.store.results import (
    AnswerFacts,
    CellData,
    CellFacts,
    ClipFacts,
    IgnoredFacts,
)
from ssp_eval.score.cell import score_cell
from ssp_vla_bridge.messages import EgoSample, Request
from ssp_vla_bridge.trajectory import Trajectory

CONDITIONS = (
    "twin.without.ot1",
    "twin.mirror.ot1",
    "twin.camera.0500",
    "twin.history.0500",
    "twin.control.car",
    "pictures.fog.2",
    "pictures.control",
    "repeat",
)
TURNED, GIVEN_BACK = "reasoning.object", "reasoning.control"
LABELS = 9


@dataclass(frozen=True)
class Scene:
    """The facts that an answer may come from.

    Args:
        side: where the object is; None: there is none, or nothing shows it.
        speed_mps: by the own history.
        is_clear: no fog lies on it.
        reason: the side that a text given back tells of; None: no text was given back.
    """

    side: str | None
    speed_mps: float
    label: int
    is_clear: bool = True
    reason: str | None = None
    has_reason: bool = False


Said = tuple[str, Slots, Trajectory]
Answerer = Callable[[Scene], Said]


def path(speed_mps: float, accel_mps2: float = 0.0) -> Trajectory:
    """Straight ahead."""
    times_s = [k * 0.5 for k in range(7)]
    ahead_m = [max(0.0, speed_mps * t + accel_mps2 * t * t / 2) for t in times_s]
    return Trajectory(tuple(times_s), tuple(ahead_m), (0.0,) * len(times_s))


def said(text: str, side: str | None, lon: str) -> Slots:
    """Slots whose evidence is the whole text."""

    def slot(value: str | tuple[str, ...]) -> Slot:
        return Slot(value, ((0, len(text)),))

    position = None if side is None else slot(f"front_{side}")
    objects = slot(() if side is None else ("car",))
    return Slots(objects, position, None, None, slot(lon), slot("straight"))


def _about(side: str | None) -> tuple[str, Slots]:
    text = "Nobody is ahead, I keep my speed." if side is None else f"A car at the {side}, I brake."
    return text, said(text, side, "maintain" if side is None else "decelerate")


def _driven(side: str | None, speed_mps: float) -> Trajectory:
    return path(speed_mps, 0.0 if side is None else -2.0)


def uses_the_object(scene: Scene) -> Said:
    """Says what it sees and drives by what it says."""
    side = scene.reason if scene.has_reason else scene.side
    return *_about(side), _driven(side, 10.0)


def decides_first(scene: Scene) -> Said:
    """Drives by what it sees, and has a text for it whatever it was given."""
    side = scene.reason if scene.has_reason else scene.side
    return *_about(side), _driven(scene.side, 10.0)


def only_talks(scene: Scene) -> Said:
    """Says what it sees and drives the same in any case."""
    return *_about(scene.side), path(10.0)


def ignores_it(scene: Scene) -> Said:
    """Says and drives the same in any case."""
    text = "The road is dry and I hold my lane."
    return text, said(text, None, "maintain"), path(10.0)


def copies_its_history(scene: Scene) -> Said:
    """Goes on as it went."""
    text = "I go on as before."
    return text, said(text, None, "maintain"), path(scene.speed_mps)


def looks_at_the_weather(scene: Scene) -> Said:
    """Slows down in fog, with or without an object."""
    text = "I can see far." if scene.is_clear else "I see little, so I slow down."
    lon = "maintain" if scene.is_clear else "decelerate"
    return text, said(text, None, lon), path(10.0, 0.0 if scene.is_clear else -2.0)


ANSWERERS: dict[str, Answerer] = {
    one.__name__: one
    for one in (
        uses_the_object,
        decides_first,
        only_talks,
        ignores_it,
        copies_its_history,
        looks_at_the_weather,
    )
}


def unsteady(answerer: Answerer, share: float, jitter_m: float, seed: int) -> Answerer:
    """The same with answers that are another one's now and then, whatever was asked."""
    numbers = random.Random(seed)

    def answer(scene: Scene) -> Said:
        if numbers.random() < share:
            scene = replace(scene, side=numbers.choice(["left", "right", None]))
        text, slots, trajectory = answerer(scene)
        ahead_m = tuple(x + numbers.gauss(0.0, jitter_m) for x in trajectory.x_m)
        return text, slots, replace(trajectory, x_m=(0.0, *ahead_m[1:]))

    return answer


def switching(after: int) -> Answerer:
    """Looks at nothing, and says and drives otherwise from one request on."""
    asked = itertools.count()

    def answer(_: Scene) -> Said:
        return uses_the_object(Scene("left" if next(asked) < after else None, 10.0, 0))

    return answer


def flipping(share: float, seed: int) -> Answerer:
    """Looks at nothing, and gives the rarer of two answers with this chance."""
    numbers = random.Random(seed)

    def answer(_: Scene) -> Said:
        return uses_the_object(Scene(None if numbers.random() < share else "left", 10.0, 0))

    return answer


def scene_under(scene: Scene, condition: str) -> Scene:
    """The scene with one cause changed."""
    match condition.split("."):
        case ["twin", "without", *_]:
            return replace(scene, side=None)
        case ["pictures", "fog", *_]:
            return replace(scene, side=None, is_clear=False)
        case ["twin", "mirror", *_]:
            other = {"left": "right", "right": "left", None: None}[scene.side]
            return replace(scene, side=other)
        case ["twin", "history", *_]:
            return replace(scene, speed_mps=scene.speed_mps / 2)
        case ["reasoning", "object"]:
            turned = None if scene.side is not None else "left"
            return replace(scene, has_reason=True, reason=turned)
        case ["reasoning", "control"]:
            return replace(scene, has_reason=True, reason=scene.side)
        case _:
            return scene


def cells_of(
    model: str,
    answerer: Answerer,
    recordings: int = 20,
    conditions: Sequence[str] = CONDITIONS,
    folder: Path = Path("campaign"),
) -> Iterator[CellData]:
    """A campaign's cells of one model, on recordings whose object comes from either side.

    It is asked in the order that a campaign asks in.
    """
    models = [ModelSpec(model, condition=condition) for condition in ("", *conditions)]
    for number in range(recordings):
        numbers = random.Random(number)
        side, since, speed_mps = (
            numbers.choice(["left", "right"]),
            numbers.randrange(1, 4),
            numbers.uniform(8.0, 12.0),
        )
        scenes = [
            Scene(side if label >= since else None, speed_mps, label) for label in range(LABELS)
        ]
        answers: dict[str, list[Said]] = {one.condition: [] for one in models}
        for stage in stages_of(models, f"sha256:{number}", LABELS):
            for scene, row in zip(scenes, stage.rows, strict=True):
                for condition in (stage.models[index].condition for index in row):
                    answers[condition].append(answerer(scene_under(scene, condition)))
        for condition, of in answers.items():
            yield cell(model, f"event_{number:02d}", condition, of, folder)


def cell(
    model: str, scenario: str, condition: str, answers: Sequence[Said], folder: Path
) -> CellData:
    """One scored cell, without files."""
    shown = f"{model}+{condition}" if condition else model
    labels = Labels(
        scenario,
        "simulation",
        "v",
        1.0,
        False,
        tuple(
            Label(
                k * 0.5,
                "conflict",
                True,
                ("car",),
                "front",
                "same_direction",
                "active",
                ("decelerate",),
                ("straight",),
            )
            for k in range(len(answers))
        ),
    )
    records = tuple(
        BehaviourRecord(k * 0.5, text, slots, trajectory)
        for k, (text, slots, trajectory) in enumerate(answers)
    )
    history = (EgoSample(0.0, 0.0, 0.0, 0.0, 10.0, 0.0),)
    asked = tuple(
        json.dumps(
            {"label_t_s": k * 0.5, **request_to_json(Request("q", 0, (), None, history, "states"))}
        ).encode()
        for k in range(len(answers))
    )
    facts = CellFacts.model_construct(
        scenario=scenario,
        domain="simulation",
        model=shown,
        model_ids=[],
        status="ok",
        reasons=[],
        stand_in=False,
        event_version="v",
        labels_source="",
        labels_proposed=False,
        clip=ClipFacts(
            origin="made up",
            verdict=None,
            ego="recorded",
            camera="recorded",
            geometry=None,
            mount_forward_m=None,
        ),
        answers=AnswerFacts(
            sent=0, reused=0, missing=[], ignored=IgnoredFacts(late=0, duplicate=0, unknown=0)
        ),
        backend_options={},
        decoding=[],
        interface="waypoints",
        condition=condition,
        control=bool(condition),
        adapter="",
        hashes={"bag": f"sha256:{scenario}"},
    )
    name = f"{scenario}__simulation__{shown}"
    return CellData(
        folder / "cells" / name, facts, labels, records, asked, score_cell(labels, records), ()
    )
