"""Faults of a command are reported before any question is asked or any file written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from ssp_core.bag.reading.reader import BagReader
from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_core.files.writing import write_json
from ssp_eval.data.labels import Labels, PhasePosition, labels_to_json
from ssp_eval.data.provenance import read_provenance
from ssp_eval.evaluate.campaign import labelled_clip
from ssp_eval.evaluate.cli import model_specs
from ssp_eval.evaluate.clients.models import CONTROLS, bridge_spec
from ssp_eval.labels.propose import propose_by_plan
from ssp_eval.labels.truth import truth_from_bag
from ssp_eval.recordings.clip import Clip
from ssp_vla_bridge.backend import BACKENDS

BagMaker = Callable[..., Path]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--bridge", "nonsense"), "known: alpamayo, constant_velocity"),
        (("--bridge", 'silent={"loud": 1}'), "is no option of silent"),
        (("--bridge", 'perfect={"loud": 1}'), "is no option of perfect"),
        (("--bridge", 'perfect={"clip_start_ns": "now"}'), "must be of type int"),
        (("--bridge", "recorded"), "file"),
        (("--bridge", "m" * 65), "a letter first, 64 at most"),
        (("--bridge", "mine={backend: python}"), "--bridge mine: is not valid JSON"),
        (
            ("--bridge", "mine={backend: python}"),
            'write --bridge \'mine={"backend": "python", …}\'',
        ),
        (("--bridge", 'silent={"backend": "copy_history"}'), "name the model otherwise"),
        (("--bridge", 'constant_velocity={"backend": "silent"}'), "is the name of an answerer"),
        (("--bridge", "mine=7"), "--bridge mine: must be a JSON object, not int"),
        (("--attach", "mine={"), 'write --attach \'mine={"interface": "waypoints"}\''),
        (("--bridge", 'mine={"function": "m:f"}'), 'NAME={"backend": …}'),
        (("--bridge", 'm={"backend": "python"}'), "function: is missing; give module:function"),
        (("--bridge", 'm={"backend": "python", "function": "my_model"}'), "names no function"),
        (("--bridge", 'm={"backend": "python", "function": "m:"}'), "names no function"),
        (("--bridge", 'm={"backend": "python", "functon": "m:f"}'), "known: first_time_s"),
        (("--bridge", 'm={"backend": "python", "function": "m:f", "step_s": 0}'), "[0.001, 60] s"),
        (("--bridge", "silent", "--adapter", "nonsense"), "unknown adapter"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_a_wrong_name_or_option_writes_nothing(
    arguments: tuple[str, ...],
    message: str,
    make_bag: BagMaker,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    bag, out = make_bag(), tmp_path / "out"
    before = sorted(tmp_path.rglob("*"))
    assert main(["evaluate", str(bag), "--propose-labels", *arguments, "--out", str(out)]) == 1
    error = capfd.readouterr().err
    assert error.count("error:") == 1
    assert message in error
    assert sorted(tmp_path.rglob("*")) == before


def test_the_usual_bridges_and_attached_ones_pass() -> None:
    names = ["constant_velocity", "opencv_baseline", "perfect", "silent"]
    assert [model.name for model in model_specs(names, [])] == names
    assert model_specs([], ["somebody_s"])[0].attached


def test_controls_are_bridges_of_ours() -> None:
    assert set(CONTROLS) == {"perfect", "silent", "recorded"}
    assert set(CONTROLS) <= set(BACKENDS)
    assert bridge_spec("perfect").options_for("f", 7) == {"labels_file": "f", "clip_start_ns": 7}
    with pytest.raises(InputError, match="not valid JSON"):
        bridge_spec("perfect={")


@pytest.mark.parametrize(
    ("verdict", "reason"),
    [
        ("invalid_harness", "a node died"),
        # The session itself said valid: the runner alone measures the whole recording.
        ("off_spec", "time gap at the conflict point: 9.100 s, K* wants 0.2 to 6 s"),
    ],
)
def test_the_runners_verdict_holds_for_the_file_in_the_bag_too(
    verdict: str, reason: str, make_bag: BagMaker
) -> None:
    bag = make_bag()
    told = {"schema": "ssp.verdict/1", "verdict": verdict, "reasons": [reason]}
    write_json(bag / "verdict.json", told)
    (file,) = bag.glob("*.mcap")
    for path in (bag, file):
        with BagReader(path) as reader:
            facts = read_provenance(reader)
        assert facts.refusal == f"the run's verdict is {verdict}: {reason}"


@pytest.mark.parametrize("scenario", ["../../elsewhere", "a/b", ".hidden", "x" * 65])
def test_a_scenario_s_name_leads_nowhere_else(
    scenario: str, make_bag: BagMaker, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    bag, out = make_bag(scenario=scenario), tmp_path / "deep" / "out"
    before = sorted(tmp_path.rglob("*"))
    arguments = ["evaluate", str(bag), "--propose-labels", "--bridge", "silent", "--out", str(out)]
    assert main(arguments) == 1
    assert "scenario: is no name that a cell's folder can have" in capfd.readouterr().err
    assert sorted(tmp_path.rglob("*")) == before


def planned(labels: Labels) -> Labels:
    """Labels at places of a plan, evenly in the phases that they have."""
    phases = [label.phase for label in labels.labels]
    places = []
    for i, phase in enumerate(phases):
        before, after = phases[:i].count(phase), phases[i:].count(phase)
        share = (before + 0.5) / (before + after)
        seconds = 0.5 * after if phase == "approach" else 0.25 + 0.5 * before
        value = seconds if phase in ("approach", "resolution") else share
        places.append(PhasePosition(phase, value))
    pairs = zip(labels.labels, places, strict=True)
    return replace(labels, plan="phase", labels=tuple(replace(one, at=at) for one, at in pairs))


@pytest.mark.parametrize(
    ("key", "of", "told"),
    [
        ("phase", 0, "phase: contradicts the plan: approach, and its place in the plan is"),
        ("at", 0, "phase: contradicts the plan: "),
        ("at", -2, "at: contradicts the plan: conflict u="),
    ],
)
def test_labels_that_contradict_their_plan_are_of_no_clip(
    key: str, of: int, told: str, make_bag: BagMaker, tmp_path: Path
) -> None:
    bag, file = make_bag(), tmp_path / "labels.json"
    (proposal,), _ = propose_by_plan([truth_from_bag(bag)])
    labels = planned(proposal.labels)
    content = labels_to_json(labels)
    write_json(file, content)
    assert labelled_clip(Clip(bag), file).labels == labels
    content["labels"][-1][key] = content["labels"][of][key]
    write_json(file, content)
    with pytest.raises(InputError) as caught:
        labelled_clip(Clip(bag), file)
    last = len(labels.labels) - 1
    assert f"labels.json: labels[{last}].{told}" in str(caught.value)
    assert "`ssp labels check` lists all" in str(caught.value)
