"""Fault files: what they add to a run, and what they are refused for."""

from __future__ import annotations

from pathlib import Path

import pytest

from ssp_core.errors import InputError
from ssp_core.run_file.faults import load_faults, with_faults
from ssp_core.run_file.model import EndCondition, Fault, Limits, LinkDisturbance, RunSpec
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.run_file.values import Start


def participant(name: str) -> ParticipantSpec:
    return ParticipantSpec(id=name, object_class="car", start=Start(x_m=0.0, y_m=0.0, yaw_rad=0.0))


RUN = RunSpec.model_construct(
    vut=participant("vut"),
    targets=[participant("ot1"), participant("ot2")],
    limits=Limits(speed_mps=20.0, acceleration_mps2=5.0, duration_s=30.0),
    end=EndCondition(at_latest_s=20.0),
    faults=[Fault(kind="operator_abort", at_s=9.0)],
    disturbance=LinkDisturbance(state_loss=0.1),
    disturbances={"ot1": LinkDisturbance(state_loss=0.2)},
)


def written(folder: Path, text: str) -> Path:
    path = folder / "faults.yaml"
    path.write_text(text)
    return path


def merged(folder: Path, text: str) -> RunSpec:
    path = written(folder, text)
    return with_faults(RUN, load_faults(path), path)


def test_faults_are_added_and_disturbances_replaced(tmp_path: Path) -> None:
    run = merged(
        tmp_path,
        """schema: ssp.faults/1
faults:
  - {kind: link_delay, target: ot1, at_s: 4.5, duration_s: 2, value: 0.225}
  - {kind: kill, target: scenario_manager, at_s: 6}
disturbances:
  ot2: {position_noise_m: 0.05}
""",
    )
    assert [f.kind for f in run.faults] == ["operator_abort", "link_delay", "kill"]
    assert run.disturbance_of("ot1").state_loss == 0.2
    assert run.disturbance_of("ot2") == LinkDisturbance(position_noise_m=0.05)
    assert run.disturbance_of("vut").state_loss == 0.1
    run = merged(tmp_path, "schema: ssp.faults/1\ndisturbance: {reorder: 0.1}\n")
    assert run.disturbance_of("vut") == LinkDisturbance(reorder=0.1)
    assert run.disturbance_of("ot1").state_loss == 0.2


@pytest.mark.parametrize(
    ("fault", "field", "says"),
    [
        ("{kind: link_cut, target: ot3}", "faults[0].target", "choose vut, ot1, ot2"),
        ("{kind: link_cut}", "faults[0].target", "choose vut, ot1, ot2"),
        ("{kind: vut_stop, target: ot1}", "faults[0].target", "choose vut"),
        ("{kind: link_delay, target: ot1}", "faults[0].value", "s, one way"),
        ("{kind: link_delay, target: ot1, value: 0}", "faults[0].value", "above 0 (s"),
        ("{kind: link_loss, target: ot1, value: 1.1}", "faults[0].value", "at most 1 (share"),
        ("{kind: vut_stop, target: vut, value: -2}", "faults[0].value", "above 0 (m/s^2)"),
        ("{kind: state_nan, target: ot1, value: 2}", "faults[0].value", "leave it out"),
        ("{kind: link_cut, target: ot1, at_s: 20.0}", "faults[0].at_s", "before 20 s"),
        ("{kind: kill, target: monitor, at_s: 25.0}", "faults[0].at_s", "before 20 s"),
        ("{kind: link_cutt, target: ot1}", "faults[0].kind", "'link_cut'"),
        ("{kind: link_cut, target: ot1, at: 3}", "faults[0].at", "did you mean at_s"),
    ],
)
def test_a_fault_that_strikes_nothing_is_refused(
    tmp_path: Path, fault: str, field: str, says: str
) -> None:
    with pytest.raises(InputError) as caught:
        merged(tmp_path, f"schema: ssp.faults/1\nfaults:\n  - {fault}\n")
    assert caught.value.field == field
    assert caught.value.file == str(tmp_path / "faults.yaml")
    assert says in str(caught.value)


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("schema: ssp.faults/1\ndisturbances: {ot7: {}}\n", "disturbances.ot7"),
        ("schema: ssp.faults/2\n", "schema"),
        ("schema: ssp.faults/1\ndisturbance: {state_loss: 1}\n", "disturbance.state_loss"),
    ],
)
def test_a_file_that_is_not_right_is_refused(tmp_path: Path, text: str, field: str) -> None:
    with pytest.raises(InputError) as caught:
        merged(tmp_path, text)
    assert caught.value.field == field
