"""A bridge that fails costs its record, never the campaign: real nodes, real topics."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ssp_core.host.domains import free_domain
from ssp_core.host.environment import session_environment
from ssp_core.host.processes import ProcessGroup
from ssp_eval.evaluate.bridges import PROFILE

pytestmark = [pytest.mark.ros, pytest.mark.system]

BagWriter = Callable[..., Path]
HERE = Path(__file__).parents[2]
# One campaign of nine label times, and a trouble for each.
SCRIPT = ("twice", "die", "nan", "other", "html", "huge", "flood", "hang", "garbage")
ANSWER_S = 2.0


class Campaign:
    """The files that a campaign of one cell has left."""

    def __init__(self, out: Path, stdout: str) -> None:
        self.line: dict[str, Any] = json.loads(stdout)
        self.folder = out / "cells" / self.line["cell"]
        self.cell: dict[str, Any] = json.loads((self.folder / "cell.json").read_text())
        self.requests, self.records, self.raw = (
            [json.loads(line) for line in (self.folder / f"{name}.jsonl").read_text().splitlines()]
            for name in ("requests", "records", "raw")
        )

    def at(self, word: str) -> tuple[dict[str, Any], dict[str, Any] | None]:
        """The question of a word of the script, and its record if there is one."""
        asked = self.requests[SCRIPT.index(word)]
        return asked, next((r for r in self.records if r["t_s"] == asked["t_s"]), None)


def run_attached(bag: Path, folder: Path, script: tuple[str, ...], *options: str) -> Campaign:
    """A campaign with the fake bridge, which runs in the same domain and isn't ours."""
    out = folder / "out"
    with free_domain() as domain_id:
        environment = session_environment(domain_id, PROFILE)
        path = os.pathsep.join([str(HERE), environment.get("PYTHONPATH", "")])
        environment["PYTHONPATH"] = path.rstrip(os.pathsep)
        with ProcessGroup(environment, folder / "logs") as group:
            parameters: dict[str, object] = {"script": ",".join(script), "count": folder / "count"}
            bridge = group.start_node("mine", "fake_bridge", parameters)
            command = [
                sys.executable,
                "-m",
                "ssp_core.cli",
                "evaluate",
                str(bag),
                "--propose-labels",
                "--attach",
                "mine",
                "--timeout",
                str(ANSWER_S),
                "--out",
                str(out),
                "--json",
                "--no-controls",
                *options,
            ]
            run = subprocess.run(
                command, env=environment, capture_output=True, text=True, timeout=600, check=False
            )
            assert bridge.returncode is None, bridge.log_tail()
    assert run.returncode == 1, run.stderr  # answers that failed to come are an outage
    return Campaign(out, run.stdout)


# What each trouble costs: the kind of the loss and a part of its reason.
LOSSES = {
    "hang": ("no answer in time", "no answer within 2 s"),
    "other": ("no answer in time", "no answer within 2 s"),
    "garbage": ("unusable answer", "the answer can't be read"),
    "huge": ("unusable answer", "the answer has 20000"),
}


def test_each_trouble_of_a_bridge_costs_its_own_record_and_has_its_reason(
    bag_writer: BagWriter, tmp_path: Path
) -> None:
    troubled = run_attached(bag_writer(tmp_path / "bag"), tmp_path, SCRIPT)
    every_label_time_counts(troubled)
    for word, (kind, reason) in LOSSES.items():
        asked, record = troubled.at(word)
        assert record is None, word
        assert asked["kind"] == kind
        assert reason in asked["missing"]
    asked, record = troubled.at("die")
    assert record is None
    # Nobody tells a client that a process of somebody else's died: it leaves the topics, or is
    # replaced there before that is noticed.
    assert asked["kind"] in ("bridge died", "no answer in time")
    odd_answers_are_kept_for_what_they_say(troubled)
    ignored = troubled.cell["answers"]["ignored"]
    # A flood hides no answer; a late one is counted, and hurts no later question.
    assert ignored["duplicate"] == 1
    assert ignored["unknown"] > 1
    assert ignored["late"] >= 1
    ids = {one["request_id"] for one in troubled.raw}
    assert troubled.at("hang")[0]["request_id"] not in ids
    # What is too large isn't stored.
    assert sum(file.stat().st_size for file in troubled.folder.iterdir()) < 1_000_000


def every_label_time_counts(troubled: Campaign) -> None:
    score, answers = troubled.line["score"], troubled.cell["answers"]
    assert (troubled.cell["status"], score["n"], score["matched"]) == ("ok", 9, 4)
    assert [one["label_t_s"] for one in troubled.requests] == [
        label["t_s"]
        for label in json.loads((troubled.folder / "labels.json").read_text())["labels"]
    ]
    lost = {one["label_t_s"]: one["kind"] for one in answers["missing"]}
    assert lost == {o["label_t_s"]: o["kind"] for o in troubled.requests if o["missing"]}
    assert len(lost) == troubled.line["missing"] == 5
    # Two of nine answers have text and a valid trajectory.
    assert score["jovr"] == pytest.approx(2 / 9)


def odd_answers_are_kept_for_what_they_say(troubled: Campaign) -> None:
    """The first of two; arrays of NaN; a page of HTML; the one in a flood."""
    records = {word: troubled.at(word)[1] for word in ("twice", "nan", "html", "flood")}
    twice, nan, html, flood = records.values()
    assert twice is not None
    assert twice["text"] == "A car is ahead. I keep my speed."
    assert nan is not None
    assert (nan["trajectory"], nan["invalid"]) == (None, ["non_finite"])
    stamp_ns = troubled.at("nan")[0]["stamp_ns"]
    stored = next(one for one in troubled.raw if one["stamp_ns"] == stamp_ns)
    assert stored["arrays"][0]["data"] == ["nan"] * 10
    assert html is not None
    assert html["text"].startswith("<html>")
    assert (html["trajectory"], html["invalid"]) == (None, ["missing"])
    assert not any(html["slots"].values())
    assert flood is not None
    assert flood["trajectory"] is not None


def test_what_may_pass_is_asked_again_and_what_can_t_be_read_is_not(
    bag_writer: BagWriter, tmp_path: Path
) -> None:
    script = ("answer", "die", "answer", "deep", "nan_decoding", "leave")
    done = run_attached(bag_writer(tmp_path / "bag"), tmp_path, script, "--retry-errors", "1")
    answers = done.cell["answers"]
    # The one that left is waited for until it is back.
    assert (answers["asked_again"], done.line["asked_again"]) == (2, 2)
    assert answers["missing_by_kind"] == {"unusable answer": 2}
    reasons = [one["reason"] for one in answers["missing"]]
    assert "the answer can't be read" in reasons[0]
    assert "decoding is no JSON" in reasons[1]
    assert done.line["score"]["n"] == 9
