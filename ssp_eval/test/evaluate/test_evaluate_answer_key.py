"""The key of a stored answer: each part of it either invalidates the answer or doesn't."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from ssp_core.hashing import sha256_bytes
from ssp_eval.evaluate.clients.models import BLACK, SHUFFLED, ModelFacts, ModelSpec, bridge_spec
from ssp_eval.evaluate.store.requests import AnswerKeys, key_of, model_facts, new_request_id
from ssp_vla_bridge import prompts
from ssp_vla_bridge.messages import CameraGeometry, EgoSample, Frame, Request, Response
from ssp_vla_bridge.prompts import PROMPTS

HISTORY = tuple(EgoSample(0.5 * k - 5.0, 5.0 * k - 50.0, 0.0, 0.0, 10.0, 0.0) for k in range(11))
REQUEST = Request("r1", 5_000, (Frame(5_000, b"x"),), None, HISTORY, "declared")
ANSWER = Response("r0", 4_000, "m", "m/1", "A car.", decoding={"seed": 1}, latency_s=0.5)
URL = "http://host:1/v1"
OPENAI = ModelSpec("m", {"base_url": URL, "model": "q"}, backend="openai")
HTTP = ModelSpec("m", {"url": URL}, backend="http")
PYTHON = ModelSpec("m", {"function": "my_model:drive"}, backend="python")
PERFECT = bridge_spec("perfect")


def key(
    model: ModelSpec = OPENAI, request: Request = REQUEST, labels: str = "sha256:l", start: int = 7
) -> str:
    return AnswerKeys(model, labels, start).of(request)


def with_options(model: ModelSpec, /, **options: Any) -> ModelSpec:
    return replace(model, options={**model.options, **options})


@pytest.mark.parametrize(
    "change",
    [
        {"stamp_ns": 5_001},
        {"frames": (Frame(5_000, b"y"),)},
        {"frames": (Frame(4_900, b"x"),)},
        {"frames": (Frame(4_000, b"x"), Frame(5_000, b"x"))},
        {"camera": CameraGeometry(1.0, 1.0, 1.0, 1.0, 2, 2)},
        {"history": HISTORY[:-1]},
        {"history": (*HISTORY[:-1], replace(HISTORY[-1], speed_mps=10.1))},
        {"ego_provenance": "measured"},
        {"task": replace(REQUEST.task, instruction="Drive.")},
        {"task": replace(REQUEST.task, objects=(*REQUEST.task.objects, "tram"))},
        {"task": replace(REQUEST.task, trajectory_step_s=0.25)},
        {"previous": ANSWER},
    ],
)
def test_another_question_is_asked(change: Mapping[str, Any]) -> None:
    assert key(request=replace(REQUEST, **change)) != key()
    assert key(PYTHON, replace(REQUEST, **change)) != key(PYTHON)


def test_the_answer_before_counts_by_what_it_says() -> None:
    first = key(request=replace(REQUEST, previous=ANSWER))
    for same in ({"request_id": "r9"}, {"latency_s": 3.0}):
        assert key(request=replace(REQUEST, previous=replace(ANSWER, **same))) == first
    for other in ({"text": "No car."}, {"decoding": {"seed": 2}}, {"stamp_ns": 4_001}):
        assert key(request=replace(REQUEST, previous=replace(ANSWER, **other))) != first
    assert key(request=replace(REQUEST, request_id="r2")) == key()


def test_the_answer_before_counts_however_it_came() -> None:
    def after(**facts: Any) -> str:
        stage = {"name": "intent", "end": 6, "latency_s": 0.5, "tries": 1, **facts}
        decoding = {"timeout_s": 57.0, "tries": facts.get("tries", 3), "stages": [stage, "odd"]}
        return key(request=replace(REQUEST, previous=replace(ANSWER, decoding=decoding)))

    assert after(latency_s=0.7, tries=2) == after()
    assert len({after(), after(end=5), after(system_fingerprint="other")}) == 3


@pytest.mark.parametrize("model", [OPENAI, HTTP], ids=["openai", "http"])
def test_what_decides_whether_an_answer_comes_isn_t_asked_again_for(model: ModelSpec) -> None:
    same = [
        with_options(model, timeout_s=9.0),
        with_options(model, tries=7),
        with_options(model, api_key_env="OTHER_KEY"),
        replace(model, timeout_s=5.0),
        replace(model, adapter="waypoints:ego_xy"),
        replace(model, facts=ModelFacts(8.0, 8.0, "dense")),
        replace(model, control=True),
        # The frames are the same, by whichever rule they were chosen.
        replace(model, preprocessing={"frame_span_s": 7.0}),
    ]
    if model is HTTP:
        same += [with_options(model, start_s=1.0), with_options(model, max_mb=3.0)]
    assert {key(one) for one in same} == {key(model)}
    assert key(model, labels="sha256:other") == key(model, start=8) == key(model)


def test_what_can_change_what_a_model_says_is_asked_again_for() -> None:
    others = [
        replace(OPENAI, name="n"),
        replace(OPENAI, condition=BLACK),
        replace(OPENAI, condition=SHUFFLED),
        with_options(OPENAI, base_url="http://other:1/v1"),
        with_options(OPENAI, model="r"),
        with_options(OPENAI, temperature=1.0),
        with_options(OPENAI, seed=2),
        with_options(OPENAI, image_width=320),
        with_options(OPENAI, extra={"top_k": 3}),
        with_options(OPENAI, interface="lightemma"),
        with_options(OPENAI, interface="waypoints"),
        HTTP,
        with_options(HTTP, url="http://other:1"),
        with_options(HTTP, interface="llavida"),
        PYTHON,
        with_options(PYTHON, options={"tries": 1}),
        # Of a backend that isn't ours nobody knows what its options mean.
        ModelSpec("m", {"tries": 1}, backend="my_backend:make"),
        ModelSpec("m", {"tries": 2}, backend="my_backend:make"),
        replace(OPENAI, attached=True, backend="", options={}),
    ]
    assert len({key(), *map(key, others)}) == len(others) + 1


def test_only_the_perfect_answerer_depends_on_labels_and_the_clip_s_start(tmp_path: Path) -> None:
    assert key(PERFECT, labels="sha256:other") != key(PERFECT)
    assert key(PERFECT, start=8) != key(PERFECT)
    assert key(bridge_spec("silent"), labels="sha256:other") == key(bridge_spec("silent"))
    file = tmp_path / "labels.json"
    file.write_text("1")
    own = with_options(PERFECT, labels_file=str(file))
    first = key(own)
    file.write_text("2")
    assert key(own) != first


def test_changed_words_ask_again_for_exactly_their_own_answers(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked = {name: with_options(OPENAI, interface=name) for name in PROMPTS}
    asked |= {f"http {name}": with_options(HTTP, interface=name) for name in (*PROMPTS, "alpamayo")}
    asked |= {
        "python": with_options(PYTHON, interface="openemma"),
        "attached": ModelSpec("m", {}, True),
    }
    before = {name: key(model) for name, model in asked.items()}

    def changed() -> set[str]:
        return {name for name, model in asked.items() if key(model) != before[name]}

    assert changed() == set()
    with monkeypatch.context() as patched:
        patched.setitem(prompts.WORDS["openemma"]["motion"], "system", "Drive well.")
        assert changed() == {"openemma"}
    with monkeypatch.context() as patched:
        patched.setitem(prompts.WORDS["lightemma"]["scene"], "text", "Be brief.")
        assert changed() == {"lightemma"}
    with monkeypatch.context() as patched:
        # An answerer that gets one prompt gets the new one; one with several builds its own.
        stages = PROMPTS["waypoints"]
        words = replace(stages[0], build=lambda request, before: shared_prompt())
        patched.setitem(PROMPTS, "waypoints", (words,))
        assert changed() == {"waypoints", "http waypoints"}
    assert changed() == set()


def shared_prompt() -> Any:
    return PROMPTS["llavida"][0].build(REQUEST, {})


def test_a_sentence_that_some_prompts_share_is_theirs(monkeypatch: pytest.MonkeyPatch) -> None:
    """UNKNOWN_PAST stands only where the history isn't known."""
    unknown = replace(REQUEST, history=(), ego_provenance="unknown")
    before = key(), key(request=unknown)
    monkeypatch.setattr(prompts, "UNKNOWN_PAST", "Nobody knows.")
    assert key() == before[0]
    assert key(request=unknown) != before[1]


def test_a_task_that_an_interface_can_t_ask_has_a_key() -> None:
    far = replace(REQUEST, task=replace(REQUEST.task, trajectory_horizon_s=50.0))
    assert key(request=far) != key()


def test_stored_answers_of_a_recording_go_by_its_content(tmp_path: Path) -> None:
    def facts(path: Path) -> dict[str, Any]:
        return model_facts(bridge_spec(f'recorded={{"file": "{path}"}}'), "", 0)

    cell = tmp_path / "out" / "cells" / "c"
    cell.mkdir(parents=True)
    for file in (tmp_path / "raw.jsonl", tmp_path / "moved.jsonl", cell / "raw.jsonl"):
        file.write_text("one")
    first = facts(tmp_path / "raw.jsonl")
    assert first["options"] == {"file": [sha256_bytes(b"one")]}
    assert facts(tmp_path / "moved.jsonl") == first
    assert facts(cell) == facts(tmp_path / "out") == first
    (cell / "requests.jsonl").write_text("other")
    (tmp_path / "out" / "run.mcap").write_text("other")
    assert facts(cell) == facts(tmp_path / "out") == first
    (cell / "raw.jsonl").write_text("two")
    assert facts(cell) != first
    (tmp_path / "metadata.yaml").write_text("")
    (tmp_path / "raw.jsonl").unlink()
    (tmp_path / "a.mcap").write_text("one")
    assert facts(tmp_path) == first


def test_stored_answers_of_a_function_go_by_its_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    def facts(
        file: str, text: str, function: str = "my_model:drive", folder: Path = tmp_path
    ) -> dict[str, Any]:
        (folder / file).parent.mkdir(exist_ok=True, parents=True)
        (folder / file).write_text(text)
        return model_facts(with_options(PYTHON, function=function, folder=str(folder)), "", 0)

    first = facts("my_model.py", "one")
    assert facts("my_model.py", "one", folder=tmp_path / "moved") == first
    assert facts("my_model.py", "two") != first
    inside = facts("package/model.py", "one", "package.model.drive")
    assert facts("package/model.py", "two", "package.model.drive") != inside
    # A folder without the module may hold what the function reads.
    nowhere = with_options(PYTHON, function="not_there:drive", folder="/a")
    assert model_facts(nowhere, "", 0)["options"]["folder"] == "/a"
    monkeypatch.syspath_prepend(str(tmp_path))
    backend = ModelSpec("m", {}, backend="my_model:make")
    own = model_facts(backend, "", 0)
    facts("my_model.py", "three")
    assert model_facts(backend, "", 0) != own
    # One of the working folder is imported where there is no other alone.
    monkeypatch.chdir(tmp_path_factory.mktemp("here"))
    Path("my_model.py").write_text("of the working folder")
    imported = model_facts(backend, "", 0)
    facts("my_model.py", "four")
    assert model_facts(backend, "", 0) != imported


def test_an_id_tells_its_key_and_is_never_used_twice() -> None:
    first, second = new_request_id(key()), new_request_id(key())
    assert first != second
    assert key_of(first) == key_of(second) == key()


@pytest.mark.parametrize("function", ["", "my_model", ":drive", "a..b:drive", ".:drive"])
def test_a_function_without_a_module_has_a_key_too(function: str) -> None:
    """The bridge says what is wrong with it; a key needs no more than its name."""
    assert key(with_options(PYTHON, function=function)) != key(PYTHON)
