"""A chat model that is shown no picture: a control beside its seeing self, marked everywhere."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from ssp_core.cli import main
from ssp_eval.evaluate.campaign import Plan, run_campaign
from ssp_eval.evaluate.cli import blinded, model_specs, reasoned
from ssp_eval.evaluate.clients.model_client import InProcessClients
from ssp_eval.evaluate.clients.model_replies import ModelReply
from ssp_eval.evaluate.clients.models import (
    BLIND,
    as_attached,
    attached_spec,
    condition_of,
    is_control_name,
)
from ssp_eval.evaluate.conditions.expansion import (
    with_controls,
    with_pictures,
    with_twin_conditions,
)
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.store.results import load_cells
from ssp_eval.report.page import write_report
from ssp_eval.statistics.rows import entering, rows_from_cells
from ssp_eval.statistics.table import by_column
from ssp_eval.statistics.tables.notices import notices
from ssp_eval.statistics.tables.scores import all_tables
from ssp_vla_bridge.messages import Request, Response
from tests.support.models.answering import Answering
from tests.support.models.llm_server import completion, serving

BagMaker = Callable[..., Path]
SEEN = (
    "A car is ahead of me in my lane. I slow down.\nTrajectory: [[4, 0], [7, 0], [9, 0], [10, 0]]"
)
GUESSED = "The road is clear. I keep my speed.\nTrajectory: [[4, 0], [8, 0], [12, 0], [16, 0]]"


def chat(name: str, url: str = "http://127.0.0.1:9/v1", **more: Any) -> str:
    options = {"backend": "openai", "interface": "waypoints", "base_url": url, "model": "seer-7b"}
    return f"{name}={json.dumps({**options, **more})}"


def respond(request: Mapping[str, Any]) -> tuple[int, bytes]:
    """Answer as a model that looks at pictures, and that guesses if it gets none."""
    seeing = isinstance(request["messages"][-1]["content"], list)
    return 200, completion(SEEN if seeing else GUESSED)


@pytest.fixture(scope="module")
def campaign(
    bag_writer: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, list[dict[str, Any]], Plan]:
    """A model, itself blind, and a blind one alone, with everything that they were asked."""
    folder = tmp_path_factory.mktemp("blind")
    plans: list[Plan] = []
    with serving(respond) as server:
        given = [
            chat("qwen", server.url),
            chat("qwen", server.url, images="none"),
            chat("smol", server.url, images="none"),
        ]
        models = model_specs(given, ())
        results = run_campaign(
            [(bag_writer(folder / "a"), None)],
            models,
            InProcessClients(),
            folder / "out",
            CellOptions(),
            True,
            on_plan=plans.append,
        )
    assert [(r.model, r.status, r.control) for r in results] == [
        ("qwen", "ok", False),
        ("qwen+blind", "ok", True),
        ("smol+blind", "ok", True),
    ]
    return folder / "out", server.requests, plans[0]


def test_the_blind_are_asked_the_same_without_a_picture(
    campaign: tuple[Path, list[dict[str, Any]], Plan],
) -> None:
    _, requests, plan = campaign
    assert plan == Plan(27, 3, 27, 0, 0, blind=18)
    assert plan.line() == "3 cells, 27 questions; of these 18 without pictures"
    contents = [request["messages"][-1]["content"] for request in requests]
    seeing = [content for content in contents if isinstance(content, list)]
    assert len(seeing) == 9
    assert all("image_url" in str(content) for content in seeing)
    blind = [content for content in contents if isinstance(content, str)]
    assert blind[:9] == blind[9:]  # the same questions, whoever is asked
    # All but the words about pictures is the question of the model that sees.
    for content, parts in zip(blind, seeing, strict=False):
        assert content.splitlines()[1:] == parts[-1]["text"].splitlines()[1:]


def test_a_blind_cell_is_a_control_and_says_so(
    campaign: tuple[Path, list[dict[str, Any]], Plan],
) -> None:
    cells = {cell.model: cell for cell in load_cells(campaign[0])}
    assert [(name, c.is_blind, c.is_control) for name, c in cells.items()] == [
        ("qwen", False, False),
        ("qwen+blind", True, True),
        ("smol+blind", True, True),
    ]
    facts = json.loads((cells["qwen+blind"].folder / "cell.json").read_text())
    assert (facts["model"], facts["condition"], facts["control"]) == ("qwen+blind", BLIND, True)
    assert facts["backend_options"]["images"] == "none"
    assert [decoding["images"] for decoding in facts["decoding"]] == ["none"]


def test_it_stands_among_the_controls_and_in_no_rank(
    campaign: tuple[Path, list[dict[str, Any]], Plan],
) -> None:
    cells = load_cells(campaign[0])
    rows = rows_from_cells(cells)
    assert {row.model for row in entering(rows)} == {"qwen"}
    tables = {table.name: table for table in all_tables(rows)}
    remarks = {str(r["model"]): str(r["remark"]) for r in by_column(tables["matrix"])}
    assert [name for name in remarks if "control, blind" in remarks[name]] == [
        "qwen+blind",
        "smol+blind",
    ]
    of_controls = {"matrix", "seeing", "answerers"}
    for name in tables.keys() - of_controls:
        assert "blind" not in str(tables[name].rows), name
    (beside,) = by_column(tables["seeing"])
    assert (beside["model"], beside["condition"], beside["n"]) == ("qwen", BLIND, 1)
    alone = [row["model"] for row in by_column(tables["answerers"])]
    assert alone == ["qwen+blind", "smol+blind"]
    told = [notice.text for notice in notices(rows, cells)]
    assert any("Blind, asked without pictures: qwen+blind, smol+blind." in text for text in told)


def test_report_and_figures_name_it(
    campaign: tuple[Path, list[dict[str, Any]], Plan], tmp_path: Path
) -> None:
    out = campaign[0]
    html = write_report(out).read_text()
    controls = html.partition('<section id="controls">')[2].partition("</section>")[0]
    assert 'class="blind"' in controls
    assert "no pictures" in controls
    assert "smol+blind" in controls
    assert "blind: the model was shown no picture" in html
    assert "none shown: blind" in html
    ranks = html.partition('<section id="ranks">')[2].partition("</section>")[0]
    assert "blind" not in ranks
    assert main(["report", str(out), "--figures", str(tmp_path / "figures")]) == 0
    assert "blind" in (tmp_path / "figures" / "matrix_controls.svg").read_text()
    others = [file for file in (tmp_path / "figures").glob("*.svg") if "controls" not in file.name]
    assert others
    assert all("+blind" not in file.read_text() for file in others)


def test_no_condition_is_put_on_top_of_being_blind() -> None:
    given = model_specs([chat("qwen", images="none"), chat("other"), chat("qwen")], ())
    models = reasoned(with_pictures(with_controls(given)))
    models = with_twin_conditions(models, ["twin.without.car"])
    names = [model.result_name for model in models]
    assert [name for name in names if BLIND in name] == ["qwen+blind"]
    assert len(names) == len(set(names))
    for name in ("qwen", "other"):
        own = [m for m in models if m.name == name and m.condition in ("black", "twin.without.car")]
        assert [m.options.get("images") for m in own] == [None, None]
    assert condition_of("qwen+blind") == ("qwen", BLIND)
    assert is_control_name("qwen+blind")
    attached = as_attached([m for m in given if m.condition == BLIND])
    assert [model.result_name for model in attached] == ["qwen+blind"]


def test_an_option_adds_the_blind_self_of_each_chat_model(
    capfd: pytest.CaptureFixture[str],
) -> None:
    """The same as if it were given by hand; one that is given stays the only one."""
    by_hand = [chat("qwen"), chat("far", max_tokens=99), "constant_velocity"]
    blind = [chat("qwen", images="none"), chat("far", max_tokens=99, images="none")]
    models = blinded(model_specs(by_hand, ()))
    assert models == model_specs([*by_hand, *blind], ())
    assert blinded(model_specs([*by_hand, blind[0]], ()))[-2:] == models[-2:]
    assert blinded(models) == models
    shown = [model.result_name for model in with_pictures(with_controls(models))]
    assert shown[-2:] == ["qwen+blind", "far+blind"]
    assert not any("blind+" in name for name in shown)
    assert main(["evaluate", "bag", "--out", "out", "--bridge", "opencv_baseline", "--blind"]) == 2
    assert "that needs the backend openai" in capfd.readouterr().err


def test_two_blind_models_of_one_name_are_refused(capfd: pytest.CaptureFixture[str]) -> None:
    command = ["evaluate", "bag", "--out", "out"]
    bridges = ["--bridge", chat("qwen", images="none")] * 2
    assert main([*command, *bridges]) == 2
    assert "model qwen+blind stands 2 times" in capfd.readouterr().err


def test_an_attached_bridge_that_was_shown_nothing_is_blind(
    make_bag: BagMaker, tmp_path: Path
) -> None:
    """The bridge wasn't declared blind, but its answers show that it saw no picture."""

    def reply(_: int, request: Request) -> ModelReply:
        told = Response(request.request_id, request.stamp_ns, "far", "m", GUESSED)
        return ModelReply(replace(told, decoding={"images": "none"}))

    models = [attached_spec("far")]
    bags: list[tuple[Path, Path | None]] = [(make_bag(), None)]
    run_campaign(bags, models, Answering(reply), tmp_path / "out", CellOptions(), True)
    (cell,) = load_cells(tmp_path / "out")
    assert (cell.model, cell.is_control) == ("far+blind", True)
