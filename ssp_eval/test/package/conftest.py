"""Evidence of one scenario, recorded and evaluated without ROS, and a package of it."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from ssp_core.cli import main
from ssp_core.files.writing import write_json
from ssp_core.hashing import sha256_file
from ssp_core.vocabulary import PHASES
from ssp_eval.audit.page import PagePictures
from ssp_eval.data.audit import Audit
from ssp_eval.data.labels import labels_to_json
from ssp_eval.data.response import ResponseLimits
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.clients.model_client import InProcessClients
from ssp_eval.evaluate.clients.models import bridge_spec
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.store.admission import load_admissions
from ssp_eval.labels.propose import propose
from ssp_eval.labels.truth import truth_from_bag
from ssp_eval.package import verify
from ssp_eval.package.contents import Contents
from ssp_eval.package.make import make_package
from ssp_eval.package.model import FileEntry
from ssp_eval.recordings.event import source_times
from ssp_scenario_manager.compile.task import load_task
from ssp_scenario_manager.event_spec.load import load_event, seal_event, write_event
from ssp_scenario_manager.event_spec.model import Event

Writer = Callable[..., Path]
MODEL = "constant_velocity"
DOMAINS = ("synthetic", "simulation", "physical")


def write_video(path: Path) -> None:
    path.parent.mkdir(parents=True)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (96, 54))
    for k in range(90):
        writer.write(np.full((54, 96, 3), k, np.uint8))
    writer.release()


def clip_labels(event: Event, version: str) -> dict[str, Any]:
    """Labels of the made-up clip, with the phases that the K* has at these times."""
    times = source_times(event)
    starts = [times[name].mid for name in ("trigger", "conflict", "resolution")]
    labels = []
    for k in range(9):
        t_s = 1.3 + 0.5 * k
        passed = sum(t_s >= start_s for start_s in starts)
        labels.append(
            {
                "t_s": t_s,
                "phase": PHASES[passed],
                "risk_visible": t_s > 3.2,
                "objects": ["car"],
                "position": "front",
                "motion": "same_direction",
                "conflict": "potential",
                "lon_actions": ["maintain"],
                "lat_actions": ["straight"],
            }
        )
    return {
        "schema": "ssp.labels/1",
        "scenario": "cut_in",
        "domain": "synthetic",
        "event_version": version,
        "risk_time_s": 3.3,
        "first_frame_dynamics": False,
        "labels": labels,
    }


def bag_hash(bag: Path) -> str:
    (file,) = bag.glob("*.mcap")
    return sha256_file(file)


@pytest.fixture(scope="session")
def evidence(
    tmp_path_factory: pytest.TempPathFactory, bag_writer: Writer, task_writer: Writer
) -> Path:
    """Return a demonstration of one scenario and one model, for tests that only read it."""
    root = tmp_path_factory.mktemp("evidence") / "demo"
    clip = root / "clips" / "cut_in.avi"
    write_video(clip)
    k_star = str(root / "clips" / "cut_in.event.yaml")
    event = load_event("cut_in")[0]
    source = event.source.model_copy(update={"sha256": sha256_file(clip)})
    write_event(Path(k_star), seal_event(event.model_copy(update={"source": source})))
    event, version = load_event(k_star)
    bags = {}
    checked = None
    for domain in ("simulation", "physical"):
        run = root / "runs" / f"cut_in-{domain}"
        task = task_writer(run / "task", domain, event=k_star, validated_by=checked, lanes=2)
        bags[domain] = bag_writer(run / "bag", domain=domain, task=task, like_k_star=True)
        shutil.copy(task / "run.yaml", run / "run.yaml")
        checked = {
            "run_id": run.name,
            "task_version": load_task(task).version,
            "bag_sha256": bag_hash(bags[domain]),
        }
    bags["synthetic"] = root / "runs" / "cut_in-synthetic" / "bag"
    assert (
        main(
            [
                "import-video",
                str(clip),
                "--ego-unknown",
                "--generator",
                str(event.source.generator),
                "--scenario",
                "cut_in",
                "--event-version",
                version,
                "--domain",
                "synthetic",
                "--out",
                str(bags["synthetic"]),
            ]
        )
        == 0
    )
    labels = labels_to_json(propose(truth_from_bag(bags["simulation"])).labels)
    for domain in ("simulation", "physical"):
        write_json(bags[domain].parent / "labels.json", {**labels, "domain": domain})
    write_json(bags["synthetic"].parent / "labels.json", clip_labels(event, version))
    runs = [str(bags[domain]) for domain in DOMAINS]
    assert main(["audit", *runs, "--out", str(root / "audits" / "cut_in")]) == 0
    results = run_campaign(
        [(bags[d], None) for d in DOMAINS],
        [bridge_spec(MODEL)],
        InProcessClients(),
        root,
        CellOptions(),
        admissions=load_admissions([root / "audits" / "cut_in"]),
    )
    assert [result.status for result in results] == ["ok"] * 3
    assert [result.admission for result in results] == ["admitted"] * 3
    return root


# What an audit isn't made from.
BESIDE_AUDITS = ("audit", "cell", "score", "raw", "records", "requests", "log_merged")


@pytest.fixture(scope="session")
def audit_cache() -> dict[object, tuple[Audit, PagePictures]]:
    """Audits made again in these tests, by the content that they were made from."""
    return {}


@pytest.fixture(autouse=True, scope="module")
def cached_audits(audit_cache: dict[object, tuple[Audit, PagePictures]]) -> Iterator[None]:
    """The same recordings are judged once: most tests change what is written of them."""
    again = verify.judge_again

    def remembered(
        contents: Contents,
        places: Sequence[FileEntry],
        event: Event | None,
        limits: ResponseLimits | None,
        scratch: Path,
    ) -> tuple[Audit, PagePictures]:
        files = [e for e in contents.files if e.role not in BESIDE_AUDITS]
        key = (
            tuple(place.path for place in places),
            frozenset((e.path, e.sha256) for e in files),
            None if event is None else event.model_dump_json(),
            None if limits is None else limits.model_dump_json(),
        )
        if key not in audit_cache:
            audit_cache[key] = again(contents, places, event, limits, scratch)
        return audit_cache[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(verify, "judge_again", remembered)
        # A helper process would remember nothing.
        patch.setattr("os.cpu_count", lambda: 1)
        yield


@pytest.fixture(scope="session")
def made(evidence: Path) -> Path:
    out = evidence.parent / "package"
    make_package([evidence], out)
    return out


@pytest.fixture
def package(made: Path, tmp_path: Path) -> Path:
    """A package of one's own."""
    return Path(shutil.copytree(made, tmp_path / "package"))


@pytest.fixture
def own(evidence: Path, tmp_path: Path) -> Path:
    """Evidence of one's own."""
    return Path(shutil.copytree(evidence, tmp_path / "demo"))
