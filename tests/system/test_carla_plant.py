"""A session whose VUT and object target CARLA's vehicle physics moves, by the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from ssp_core import names
from ssp_core.bag.reading.reader import BagReader
from ssp_core.carla.record import CarlaPlantRecord
from ssp_core.cli import main
from ssp_core.run_file.model import load_run
from ssp_eval.audit.server import CODE, server_disclosures, server_findings
from ssp_eval.data.provenance import read_provenance
from tests.support.carla.commands import left_as_found
from tests.support.carla.counterpart import Behaviour, Counterpart
from tests.support.carla.physics import Physics
from tests.support.carla.tasks import MAP, compiled, with_small_pictures

pytestmark = [pytest.mark.ros, pytest.mark.system, pytest.mark.carla]
# None of its numbers is one of ours.
OTHER = Physics(
    engine=5.5,
    brakes=11.0,
    lag=0.08,
    steer_lag=0.12,
    most_deg=55.0,
    wheelbase=3.1,
    drag=0.01,
    drifts=-0.2,
)


def test_a_session_that_carla_moves(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], start_session: Any
) -> None:
    task, run = with_small_pictures(compiled("cut_in", tmp_path / "task")), tmp_path / "run"
    with Counterpart(Behaviour(xodr=MAP.read_text(), physics=OTHER)) as server:
        moved = ("--plant", f"carla://{server.address}", "--json")
        session = start_session(str(task), "--seed", "11", *moved)
        assert session.finish()["verdict"] == "valid", session.lines
        left_as_found(server)
        address = server.address
    assert load_run(run / "run.yaml").plant == "carla"
    with BagReader(run / "bag") as bag:
        (said,) = bag.messages([names.absolute(names.WORLD_PLANT)])
        record = CarlaPlantRecord.model_validate_json(bag.decode(said).data)
        facts = read_provenance(bag)
    assert (record.address, record.step_s, record.counterpart) == (address, 0.02, True)
    assert record.responses["vut"]["brake_mps2"] == pytest.approx(11.0, rel=0.2)
    told = server_disclosures(facts)
    assert "vehicle physics of CARLA 0.9.16" in told["plant"]
    assert "full brake" in told["moved by CARLA: ot1"]
    assert [finding.code for finding in server_findings(facts)] == [CODE]
    # Run again, nothing guesses the server.
    for arguments, words in (
        ((run,), "is missing, and the run of this folder uses CARLA"),
        ((run, "--plant", "gazebo"), "names neither bodies nor a server"),
        ((task, "--plant", "carla://localhost:1", "--mode", "realtime"), "in lockstep only"),
        (("cut_in", "--plant", "carla://localhost:1"), "no CARLA server has that map"),
        (
            (task, "--plant", "carla://localhost:1", "--camera", "carla://localhost:5"),
            "one client ticks a server",
        ),
        ((task, "--plant", "carla://localhost:1", "--mode", "live"), "a simulated session alone"),
        ((task, "--plant", "carla://localhost:1", "--in-process"), "a simulated session alone"),
    ):
        out = tmp_path / "refused"
        status = main(["run", *map(str, arguments), "--out", str(out)])
        error = " ".join(capsys.readouterr().err.split())
        assert status == (2 if "alone" in words else 1), error
        assert words in error
        assert not out.exists()
