"""The models of a campaign as people write them, and what is refused in them."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.cli import model_specs
from ssp_eval.evaluate.clients.model_client import InProcessClients
from ssp_eval.evaluate.clients.models import (
    ModelSpec,
    as_attached,
    attached_spec,
    bridge_spec,
    load_models,
    refuse_secrets,
)
from ssp_eval.evaluate.conversation import CellOptions
from ssp_vla_bridge.window import INTERFACES, Preprocessing

BagMaker = Callable[..., Path]
FILE = """
schema: ssp.models/1
models:
  qwen_8b:
    backend: constant_velocity
    timeout_s: 90
    frames: 4
    history_s: 1.0
    total_b: 8.2
    active_b: 8.2
    architecture: dense
  qwen_30b_a3b:
    backend: constant_velocity
    adapter: waypoints:ego_xy
    total_b: 30.5
    active_b: 3.3
    architecture: moe
"""


def written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_two_models_over_one_backend(make_bag: BagMaker, tmp_path: Path) -> None:
    models = load_models(written(tmp_path / "models.yaml", FILE))
    bag, out = make_bag(), tmp_path / "out"
    results = run_campaign([(bag, None)], models, InProcessClients(), out, CellOptions(), True)
    assert [result.status for result in results] == ["ok", "ok"]
    small, large = (json.loads((r.folder / "cell.json").read_text()) for r in results)
    assert (small["model"], large["model"]) == ("qwen_8b", "qwen_30b_a3b")
    assert small["backend"] == large["backend"] == "constant_velocity"
    assert small["model_facts"] == {"total_b": 8.2, "active_b": 8.2, "architecture": "dense"}
    assert large["model_facts"]["active_b"] == 3.3
    # Each is asked by its own preprocessing, from the same open bag.
    assert (small["preprocessing"]["frames"], large["preprocessing"]["frames"]) == (4, 10)
    assert small["hashes"]["preprocessing"] != large["hashes"]["preprocessing"]
    for result, frames, samples in ((results[0], 4, 11), (results[1], 10, 21)):
        asked = [json.loads(line) for line in (result.folder / "requests.jsonl").open()]
        assert max(len(one["frames"]) for one in asked) == frames
        assert max(len(one["history"]) for one in asked) == samples
    assert (small["adapter"], small["interface"]) == ("waypoints:ego_xy", "waypoints")


def test_the_file_in_the_documents_is_one(tmp_path: Path) -> None:
    text = (Path(__file__).parents[4] / "docs" / "bridges.md").read_text()
    (example,) = re.findall(r"```yaml\n(schema: ssp\.models/1\n.*?)```", text, re.S)
    models = load_models(written(tmp_path / "models.yaml", example))
    assert [model.model_interface.name for model in models] == ["openemma", "alpamayo"]
    assert models[0].read_by() == "openemma:corrected"


@pytest.mark.parametrize(
    ("change", "field", "problem", "remedy"),
    [
        ({"schema": "ssp.models/2"}, "schema", "Input should be", "give ssp.models/1"),
        ({"models": {}}, "models", "at least 1 item", "give at least one model by name"),
        ({"more": 1}, "more", "is not a known key", "known: schema, models"),
        ({"models": [1]}, "models", "valid dictionary", "give at least one model by name"),
    ],
    ids=["schema", "none", "key", "list"],
)
def test_a_wrong_file_is_refused_with_its_place(
    change: dict[str, Any], field: str, problem: str, remedy: str, tmp_path: Path
) -> None:
    value = {"schema": "ssp.models/1", "models": {"m": {"backend": "silent"}}, **change}
    path = written(tmp_path / "models.yaml", yaml.safe_dump(value))
    with pytest.raises(InputError) as caught:
        load_models(path)
    error = caught.value
    assert (error.file, error.field) == (str(path), field)
    assert problem in error.problem
    assert remedy in (error.remedy or "")


@pytest.mark.parametrize(
    ("entry", "field", "message"),
    [
        ({"timeout_s": 0}, "timeout_s", "greater than or equal to 0.1 (got 0); give 0.1 to 86400"),
        ({"timeout_s": "90"}, "timeout_s", "valid number (got '90')"),
        ({"frames": 2.5}, "frames", "valid integer (got 2.5); give a whole number"),
        ({"temperature": 0}, "temperature", "is no key of a model; known: backend, attached"),
        ({"interface": "gpt"}, "interface", "unknown interface (got 'gpt'); known: alpamayo"),
        ({"adapter": "gpt"}, "adapter", "unknown adapter (got 'gpt'); known:"),
        ({"adapter": "waypoints:x"}, "adapter", "unknown mode of the adapter"),
        ({"options": {"api_key": "x"}}, "options.api_key", "is a secret's place"),
        ({"api_key": "secret-value-1234"}, "api_key", "is a secret's place"),
        (
            {"options": {"headers": {"Authorization": "Bearer abcdefgh12345"}}},
            "options.headers.Authorization",
            "is a secret's place",
        ),
        (
            {"options": {"base_url": "https://me:pass@host/v1"}},
            "options.base_url",
            "looks like a secret",
        ),
        (
            {"total_b": 3.3, "active_b": 30.5},
            "active_b",
            "is more than the model has, 3.3 (total_b) (got 30.5); give the parameters",
        ),
        ({"attached": True, "backend": "silent"}, "backend", "has its backend and options"),
        ({"attached": True, "options": {"a": 1}}, "options", "has its backend and options"),
        (
            {"interface": "openemma", "options": {"interface": "lightemma"}},
            "options.interface",
            "is 'lightemma', and the model's interface is 'openemma'",
        ),
    ],
    ids=lambda value: "" if isinstance(value, dict) else None,
)
def test_a_wrong_entry_is_refused_with_its_place(
    entry: dict[str, Any], field: str, message: str, tmp_path: Path
) -> None:
    value = {"schema": "ssp.models/1", "models": {"m": entry}}
    path = written(tmp_path / "models.yaml", yaml.safe_dump(value))
    with pytest.raises(InputError) as caught:
        load_models(path)
    assert caught.value.field == f"models.m.{field}"
    assert caught.value.file == str(path)
    assert message in str(caught.value)
    assert caught.value.remedy
    for hidden in ("secret-value-1234", "abcdefgh12345", "me:pass"):
        assert hidden not in str(caught.value)
    if "secret" in message:
        assert "api_key_env" in str(caught.value)


def test_a_name_that_is_none_and_a_missing_file(tmp_path: Path) -> None:
    path = written(tmp_path / "m.yaml", "schema: ssp.models/1\nmodels: {'a b': {}}\n")
    with pytest.raises(InputError, match="no name for a topic"):
        load_models(path)
    with pytest.raises(InputError, match="can't be read"):
        load_models(tmp_path / "none.yaml")


def test_a_bridge_on_the_command_line_has_the_same_parts() -> None:
    text = 'mine={"backend": "openai", "adapter": "waypoints", "timeout_s": 90, "model": "q-8b"}'
    spec = bridge_spec(text)
    assert (spec.backend_name, spec.adapter, spec.timeout_s) == ("openai", "waypoints", 90)
    assert dict(spec.options) == {"model": "q-8b"}
    # Interface, and by it preprocessing and adapter, come from the backend and its options.
    assert spec.model_interface is INTERFACES["openemma"]
    assert spec.rules == INTERFACES["openemma"].preprocessing
    other = bridge_spec('x={"backend": "openai", "interface": "llavida", "adapter": "waypoints"}')
    assert other.model_interface is INTERFACES["llavida"]
    assert bridge_spec("constant_velocity").rules == Preprocessing()
    assert bridge_spec("constant_velocity").read_by() == "waypoints:ego_xy"
    attached = attached_spec('mine={"interface": "llavida", "adapter": "waypoints"}')
    assert (attached.attached, attached.model_interface.name) == (True, "llavida")
    with pytest.raises(InputError, match="has its backend and options already"):
        attached_spec('mine={"backend": "silent"}')
    with pytest.raises(InputError, match="is a secret's place"):
        bridge_spec('mine={"backend": "openai", "api_key": "abc"}')


def test_the_interface_of_an_entry_is_told_to_its_backend(tmp_path: Path) -> None:
    text = """
    schema: ssp.models/1
    models:
      a: {backend: http, interface: llavida, adapter: waypoints, options: {url: "http://127.0.0.1:9"}}
      b: {backend: constant_velocity, interface: llavida, adapter: waypoints}
    """
    first, second = load_models(written(tmp_path / "m.yaml", text))
    assert first.options["interface"] == "llavida"
    with pytest.raises(InputError, match="speaks waypoints, not llavida"):
        model_specs([], [], [tmp_path / "m.yaml"])
    assert second.rules == INTERFACES["llavida"].preprocessing


def test_a_file_of_models_that_run_already(tmp_path: Path) -> None:
    path = written(tmp_path / "models.yaml", FILE + "    options: {}\n")
    specs = as_attached(load_models(path))
    assert all(spec.attached and not spec.backend and not spec.options for spec in specs)
    assert [spec.rules.frames for spec in specs] == [4, 10]
    assert [spec.timeout_s for spec in specs] == [90, None]


def test_a_refused_file_writes_nothing(
    make_bag: BagMaker, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    bag, out = make_bag(), tmp_path / "out"
    path = written(tmp_path / "models.yaml", FILE.replace("frames: 4", "frames: 0"))
    arguments = ["evaluate", str(bag), "--propose-labels", "--models", str(path)]
    assert main([*arguments, "--out", str(out)]) == 1
    error = capfd.readouterr().err
    assert "models.qwen_8b.frames" in error
    assert "(got 0)" in error
    assert not out.exists()


def test_one_adapter_for_all_overrides_each_model_s_own(make_bag: BagMaker, tmp_path: Path) -> None:
    spec = bridge_spec('m={"backend": "constant_velocity", "adapter": "waypoints"}')
    with pytest.raises(InputError, match="unknown mode"):
        run_campaign(
            [(make_bag(), None)],
            [spec],
            InProcessClients(),
            tmp_path / "out",
            CellOptions(adapter="waypoints:other"),
            True,
        )
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "options",
    [
        {"max_tokens": 512, "stop_token": "</s>", "top_k": 3, "api_key_env": "MY_KEY"},
        {"tokenizer": "q", "keyframes": 4, "monkey": 1, "url": "http://host:8000/v1"},
        {"model": "Qwen/Qwen3-VL-30B-A3B-Instruct", "function": "risk_model:drive"},
    ],
    ids=["sampling", "names", "models"],
)
def test_usual_options_are_no_secrets(options: dict[str, Any]) -> None:
    refuse_secrets(options)


@pytest.mark.parametrize(
    "name",
    [
        "api_key",
        "API-KEY",
        "x-api-key",
        "apikey",
        "openai_api_key",
        "hf_token",
        "token",
        "authorization",
        "password",
        "client_secret",
        "key",
    ],
)
@given(value=st.text(min_size=1))
def test_names_of_secrets_are_refused_whatever_they_hold(name: str, value: str) -> None:
    with pytest.raises(InputError, match="api_key_env") as caught:
        refuse_secrets({"options": {name: value}})
    assert caught.value.value is None


_WORDS = st.sampled_from(["backend", "options", "interface", "frames", "timeout_s", "m", "x y"])
_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | _WORDS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(_WORDS | st.text(), inner),
    max_leaves=12,
)


@given(entry=_VALUES, name=_WORDS | st.text())
def test_no_entry_makes_anything_but_a_refusal(entry: Any, name: str) -> None:
    """A models file or ``--bridge NAME=`` with any content yields a model or an InputError."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "models.yaml"
        text = json.dumps({"schema": "ssp.models/1", "models": {name: entry}})
        path.write_text(text)
        for read in (lambda: load_models(path), lambda: bridge_spec(f"m={json.dumps(entry)}")):
            with suppress(InputError):
                assert isinstance(read(), list | ModelSpec)
