"""A video alone counts as what a named person saw in it, and as nothing else (METHOD 4.3, 4.4)."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from observation_files import answers, changed, seal

from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_core.files.writing import write_json, write_text
from ssp_core.hashing import sha256_file
from ssp_core.vocabulary import DOMAINS
from ssp_eval.audit.evidence.recording import read_recording
from ssp_eval.audit.judge import judge
from ssp_eval.data.audit import RecordingEntry
from ssp_eval.package.make import make_package
from ssp_eval.package.verify import verify_package
from ssp_scenario_manager.event_spec.load import event_version, load_event, seal_event, write_event
from ssp_scenario_manager.event_spec.model import Event


def write_clip(path: Path, first: int) -> None:
    """Nine seconds of grey at 12 Hz: what can be seen in it is said by the observer alone."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 12.0, (96, 54))
    for k in range(108):
        frame = np.full((54, 96, 3), first + k, np.uint8)
        frame[:, :16] = 10 * (first - 60)  # Another camera's pictures are other pictures.
        writer.write(frame)
    writer.release()


@pytest.fixture(scope="module")
def event(tmp_path_factory: pytest.TempPathFactory) -> Event:
    """The shipped K*, bound to a source clip beside which its recordings lie."""
    root = tmp_path_factory.mktemp("videos")
    write_clip(root / "synthetic.mp4", 60)
    shipped, _ = load_event("cut_in")
    digest = sha256_file(root / "synthetic.mp4")
    source = shipped.source.model_copy(update={"sha256": digest, "original": str(root)})
    return seal_event(shipped.model_copy(update={"source": source}))


@pytest.fixture
def videos(event: Event, tmp_path: Path) -> dict[str, Path]:
    """Three imported videos; the two that aren't the source have no observation yet."""
    found = {}
    for number, domain in enumerate(("synthetic", "simulation", "physical")):
        clip = tmp_path / f"{domain}.mp4"
        write_clip(clip, 60 + number)
        found[domain] = tmp_path / domain
        assert (
            main(
                [
                    "import-video",
                    str(clip),
                    "--ego-unknown",
                    "--scenario",
                    "cut_in",
                    "--domain",
                    domain,
                    "--event-version",
                    event_version(event),
                    "--generator",
                    "somebody",
                    "--declared-by",
                    "Eve Hall",
                    "--declared-on",
                    "2026-03-01",
                    "--place",
                    "hall",
                    "--out",
                    str(found[domain] / "bag"),
                ]
            )
            == 0
        )
    return found


def observation_content(**changes: Any) -> dict[str, Any]:
    """Return the observation of a person who saw K*'s event, with changes at the named fields."""
    content = answers()
    content["topology"] |= {"lanes_opposite": 2}
    for phase, t_s in (("trigger", 3.3), ("conflict", 3.5), ("resolution", 5.6)):
        content["phases"][phase] = {"t_s": t_s, "frames": [round(12 * t_s)]}
    content["visibility"]["conflict_region"]["value"] = "throughout"
    for path, value in changes.items():
        content = changed(path.replace("__", "."), value, content)
    return content


def look(run: Path, who: str = "Ada Vance", **changes: Any) -> Path:
    name = who.split()[0].lower()
    return seal(
        run / "bag", run / f"observation_{name}.json", observation_content(who=who, **changes)
    )


def audited(videos: dict[str, Path], event: Event) -> list[RecordingEntry]:
    recordings = [read_recording(videos[d]) for d in ("synthetic", "simulation", "physical")]
    audit = judge(recordings, event).audit
    assert audit.contradiction() is None
    return audit.recordings


def codes(entry: RecordingEntry) -> set[str]:
    return {f.code for reason in entry.reasons for f in (reason, *reason.consequences)}


def test_videos_that_a_person_looked_at_are_admitted(videos: dict[str, Path], event: Event) -> None:
    look(videos["simulation"])
    path = look(videos["physical"])
    found = audited(videos, event)
    assert [(entry.status, codes(entry)) for entry in found] == [("admitted", set())] * 3
    assert [entry.kpr for entry in found] == [1.0] * 3
    physical = found[2]
    assert physical.epd is not None
    assert physical.epd > 0.0
    assert physical.phases.trigger_s == 3.3
    assert physical.observations is not None
    assert physical.observations.observers == ["Ada Vance"]
    assert physical.observations.files == {path.name: sha256_file(path)}
    assert "observed by Ada Vance" in physical.properties["topology"].how


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"topology__segment": None}, "unverified"),
        ({"topology__segment": "curve"}, "topology_differs"),
        ({"roles__participants__ot1__class": "truck"}, None),
        ({"conflict_type__value": "following"}, None),
        ({"passing_order__value": ["vut", "ot1"]}, None),
        ({"source_gate__identity__value": True}, "source_rejected"),
        ({"source_gate__road__value": None}, "unverified"),
        ({"identity_stable__value": False}, "identity_switch"),
        ({"log__safety_abort": True}, "safety_abort"),
        ({"log__identity_switch": None}, "unverified"),
        ({"visibility__participants__ot1__value": 0.3}, "participant_off_camera"),
        ({"phases__conflict__t_s": None}, "conflict_phase"),
        # An order that a person saw is determined, and K* has another.
        ({"passing_order__value": ["vut", "ot1"]}, "off_spec"),
    ],
)
def test_what_was_seen_otherwise_or_not_at_all_refuses(
    changes: dict[str, Any], code: str | None, videos: dict[str, Path], event: Event
) -> None:
    look(videos["simulation"])
    look(videos["physical"], **changes)
    found = audited(videos, event)
    assert [entry.status for entry in found] == ["unpaired", "unpaired", "refused"]
    assert code is None or code in codes(found[2]), codes(found[2])
    if code == "unverified" and "topology__segment" in changes:
        assert found[2].kpr is None


def test_two_persons_who_differ_leave_it_unverified_and_two_who_agree_do_not(
    videos: dict[str, Path], event: Event
) -> None:
    look(videos["simulation"])
    look(videos["physical"])
    look(videos["physical"], "Bo Ek", phases__trigger__t_s=3.35)
    found = audited(videos, event)
    assert found[2].status == "admitted"
    assert found[2].phases.trigger_s == pytest.approx(3.325)
    look(videos["physical"], "Bo Ek", conflict_type__value="following")
    refused = audited(videos, event)[2]
    assert (refused.status, refused.kpr, refused.epd is None) == ("refused", None, True)
    assert "unverified" in codes(refused)
    assert refused.observations is not None
    (row,) = [row for row in refused.observations.rows if row.field == "conflict_type.value"]
    assert (row.values, row.verdict) == (["merge", "following"], "differ")


def test_a_draft_or_a_changed_file_beside_the_bag_is_an_error(videos: dict[str, Path]) -> None:
    path = look(videos["physical"])
    write_json(
        videos["physical"] / "observation_bo.json",
        {
            **observation_content(),
            "who": "Bo Ek",
            "when": "2026-03-02T10:00:00Z",
            "recording": "physical",
            "bag_sha256": "sha256:" + "0" * 64,
        },
    )
    with pytest.raises(InputError, match="is a draft"):
        read_recording(videos["physical"])
    (videos["physical"] / "observation_bo.json").unlink()
    path.write_text(path.read_text().replace("merge", "crossing"))
    with pytest.raises(InputError, match="was changed after Ada Vance sealed it"):
        read_recording(videos["physical"])


def test_what_somebody_saw_must_not_differ_from_what_was_measured(
    make_bag: Callable[..., Path],
    make_task: Callable[..., Path],
    videos: dict[str, Path],
    event: Event,
) -> None:
    bag = make_bag("measured/bag", task=make_task(lanes=2), like_k_star=True)
    seal(bag, bag.parent / "observation.json", changed("conflict_type.value", "crossing"))
    found = audited({**videos, "simulation": bag.parent}, event)[1]
    assert found.properties["conflict_type"].words == {"paths": ["merge"]}
    assert "observation_differs" in codes(found)


def test_the_package_walks_from_the_audit_to_the_observation_and_to_the_recording(
    videos: dict[str, Path], event: Event, tmp_path: Path
) -> None:
    for domain in ("simulation", "physical"):
        look(videos[domain])
    write_text(tmp_path / "cut_in.event.yaml", event.model_dump_json(by_alias=True))
    runs = [str(videos[domain]) for domain in ("synthetic", "simulation", "physical")]
    arguments = ["--event", str(tmp_path / "cut_in.event.yaml"), "--out", str(tmp_path / "audit")]
    assert main(["audit", *runs, *arguments]) == 0
    out = tmp_path.parent / f"{tmp_path.name}-package"
    table, _ = make_package([tmp_path], out)
    links = {
        (link.source.split("/", 1)[1], link.target.split("/", 1)[1])
        for link in table.links
        if link.kind in ("observation", "bag")
    }
    seen_file = "physical/observation_ada.json"
    assert ("audit/audit.json", seen_file) in links
    assert (seen_file, "physical/bag/bag_0.mcap") in links
    assert verify_package(out).ok
    # Sealed anew by somebody else it is another file, though it says the same.
    (videos["physical"] / "observation_ada.json").unlink()
    look(videos["physical"], "Bo Ek")
    with pytest.raises(InputError, match="names an observation that is not in the package"):
        make_package([tmp_path], tmp_path.parent / f"{tmp_path.name}-other")


def test_label_times_of_a_video_lie_in_the_phases_that_a_person_saw_in_it(
    videos: dict[str, Path], event: Event, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """K*'s phases are those of its own source clip; no other recording's labels lie by them."""
    file = tmp_path / "k.event.yaml"
    write_event(file, event)
    given = [str(videos["synthetic"]), str(videos["physical"]), "--event", str(file)]
    assert main(["labels", "new", *given]) == 1
    assert "the times of its phases are unknown" in " ".join(capsys.readouterr().err.split())
    look(videos["physical"])
    assert main(["labels", "new", *given]) == 0
    found = {d: json.loads((videos[d] / "labels.json").read_text())["labels"] for d in DOMAINS[::2]}
    times = {d: [label["t_s"] for label in labels] for d, labels in found.items()}
    # Trigger, conflict and resolution at 3.208, 3.333, 5.5 s, and at 3.3, 3.5, 5.6 s.
    assert times["synthetic"][2:5] == pytest.approx([2.708, 3.2705, 3.333 + 2.167 / 8])
    assert times["physical"][2:5] == pytest.approx([2.8, 3.4, 3.5 + 2.1 / 8])
    assert [t[-1] for t in times.values()] == pytest.approx([5.75, 5.85])
    assert [x["at"] for x in found["physical"]] == [x["at"] for x in found["synthetic"]]
