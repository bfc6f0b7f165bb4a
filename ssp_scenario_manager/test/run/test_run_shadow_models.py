"""``--shadow``: what is asked of a bridge beside a session, and what is refused."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from ssp_core.errors import InputError
from ssp_core.names import MONITOR, absolute, declared_topic
from ssp_core.run_file.model import RunSpec, load_run
from ssp_core.run_file.participation import declaring
from ssp_scenario_manager.run.over_dds import session as over_dds
from ssp_scenario_manager.run.over_dds.companions import RECORDED, Companion, shadow_model
from ssp_scenario_manager.run.over_dds.live import LiveSetup
from tests.support.runs import cut_in_run


def test_a_name_alone_follows_twice_a_second() -> None:
    model = shadow_model("opencv_baseline")
    assert model.parameters == {"model": "opencv_baseline", "shadow_hz": 2.0}


def test_what_is_not_the_bridges_own_goes_to_its_backend() -> None:
    text = (
        'qwen={"backend": "openai", "interface": "openemma", "hz": 1, "timeout_s": 9, '
        '"model": "m", "seed": 3}'
    )
    parameters = dict(shadow_model(text).parameters)
    options = json.loads(json.loads(str(parameters.pop("backend_options"))))
    assert options == {"model": "m", "seed": 3}
    assert parameters == {
        "model": "qwen",
        "shadow_hz": 1.0,
        "backend": "openai",
        "interface": "openemma",
        "timeout_s": 9.0,
    }


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("a/b", "--shadow"),
        ("", "--shadow"),
        ("m={", "--shadow"),
        ("m=[1]", "--shadow"),
        ('m={"hz": 1, "hz": 2}', "--shadow"),
        ('m={"hz": 0}', "--shadow hz"),
        ('m={"hz": true}', "--shadow hz"),
        ('m={"hz": "2"}', "--shadow hz"),
        ('m={"timeout_s": "long"}', "--shadow timeout_s"),
    ],
)
def test_what_cannot_be_meant_is_refused_with_its_field(text: str, field: str) -> None:
    with pytest.raises(InputError) as refusal:
        shadow_model(text)
    assert refusal.value.field == field


def test_the_recorder_takes_answers_and_health_and_no_requests() -> None:
    taken = re.compile(RECORDED)
    assert taken.search("/ssp/vla/m/response")
    assert taken.search("/diagnostics")
    assert not taken.search("/ssp/vla/m/request")
    assert not taken.search("/other/ssp/vla/m/response")


class HasBegun(Exception):
    """All processes of a session would be there."""


def begun(
    folder: Path, shadows: Sequence[Companion], monkeypatch: pytest.MonkeyPatch
) -> tuple[RunSpec, dict[str, dict[str, Any]], list[str]]:
    """Begin a live session whose processes are only noted.

    Returns:
        The run file that it leaves, parameters by node, and what runs beside it.
    """
    nodes: dict[str, dict[str, Any]] = {}
    companions: list[str] = []

    class Group:
        def __init__(self) -> None:
            self.env = {"ROS_DOMAIN_ID": "0", "FASTRTPS_DEFAULT_PROFILES_FILE": "hosts.xml"}
            self.after_end = ExitStack()

        def start_node(self, name: str, _: str, parameters: dict[str, Any], *_more: object) -> None:
            nodes[name] = dict(parameters)

    @contextmanager
    def group(*_: object) -> Iterator[Group]:
        yield Group()

    @contextmanager
    def beside(_: Group, given: Sequence[Companion], *_more: object) -> Iterator[None]:
        companions.extend(companion.name for companion in given)
        yield

    def follow(*_: object) -> None:
        raise HasBegun

    monkeypatch.setattr(over_dds, "_process_group", group)
    monkeypatch.setattr(over_dds, "beside", beside)
    monkeypatch.setattr(over_dds, "follow", follow)
    run = RunSpec.model_validate({**cut_in_run(), "mode": "live", "camera": {}})
    folder.mkdir()
    with pytest.raises(HasBegun):
        over_dds.run_session(run, folder, lambda _: None, LiveSetup({}), shadows=shadows)
    return load_run(folder / "run.yaml"), nodes, companions


def test_a_model_that_follows_declares_nothing_and_nobody_less_declares(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It moves nothing and draws nothing, so what a session was doesn't depend on it (METHOD 4.4b).

    Not even if it is named as a participant is.
    """
    alone, nodes, _ = begun(tmp_path / "alone", (), monkeypatch)
    assert declaring(alone) == ("vut", "vut/positioning", "vut/camera", "ot1", "ot1/body")
    shadows = [shadow_model("vut"), shadow_model("ot1")]
    run, with_models, companions = begun(tmp_path / "followed", shadows, monkeypatch)
    assert companions == ["vla_bridge_vut", "vla_bridge_ot1"]
    assert declaring(run) == declaring(alone)
    include = with_models[MONITOR].pop("include")
    for parameters in (*nodes.values(), *with_models.values()):
        for name in ("run_file", "bag_dir"):
            parameters.pop(name, None)
    assert with_models == nodes
    # What is recorded for the models takes no word of a participant, and leaves none out.
    declared = [absolute(declared_topic(who)) for who in declaring(run)]
    assert not any(re.search(include, topic) for topic in declared)
