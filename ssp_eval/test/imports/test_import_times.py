"""Times at import: stamps that leap, rates that vary, and what lies outside the crop."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foreign_recordings import (
    Message,
    cut_in,
    imported,
    jpeg,
    number_of,
    picture,
    stamp,
    write_bag,
)

from ssp_core.bag.pictures.frames import Frames
from ssp_core.bag.reading.reader import BagReader
from ssp_core.cli import main
from ssp_core.clock import NS_PER_S
from ssp_eval.importers.ros_bag import SourceBag
from ssp_eval.importers.target import keep_every, thin

OPTIONS = (
    "--vut",
    "/vut/odom",
    "--object",
    "ot1=/ot1/odom:car",
    "--camera",
    "/cam",
    "--domain",
    "simulation",
)
IMAGE = "/ssp/vut/front_camera/image/compressed"
DAY = cut_in(12.0)


def run(bag: Path, out: Path, *options: object) -> int:
    return main(["import-bag", str(bag), *OPTIONS, *map(str, options), "--out", str(out)])


def leaping(every: int) -> Callable[[int, Any], Any]:
    """Frames of which one in so many has a stamp 7 s ahead."""

    def make(ns: int, image: Any) -> Any:
        step = (ns - DAY.zero_ns) // DAY.frame_step_ns
        message = jpeg(ns, image)
        if step % every != every - 1:
            return message
        return replace(message, header=replace(message.header, stamp=stamp(ns + 7 * NS_PER_S)))

    return make


def test_a_stamp_that_leaps_takes_the_time_of_receipt_and_that_is_said(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "day", DAY.messages(leaping(101)))
    assert run(bag, tmp_path / "rec") == 0
    _, provenance = imported(tmp_path / "rec")
    assert provenance.imported is not None
    assert provenance.imported.states is not None
    (said,) = [note for note in provenance.imported.states.notes if "usual distance" in note]
    assert said.startswith("camera: 1 of 121 stamps leave their usual distance to the time of")
    assert "the first at 10.000 s of the clip" in said
    shown = pictures_in(tmp_path / "rec")
    assert [ns - shown[0][0] for ns, _ in shown] == [k * DAY.frame_step_ns for k in range(121)]
    assert [number for _, number in shown] == list(range(121))


def test_above_one_in_a_hundred_leaps_are_refused_unless_they_are_accepted(
    tmp_path: Path, refused: Callable[..., str]
) -> None:
    bag = write_bag(tmp_path / "day", DAY.messages(leaping(50)))
    said = refused("import-bag", bag, *OPTIONS, "--out", tmp_path / "rec")
    assert "/cam: 2 of 121 stamps leave their usual distance to the time of receipt" in said
    assert "by more than 1 s, the first at 4.900 s of the clip [leaping_stamps]" in said
    assert run(bag, tmp_path / "rec", "--accept", "leaping_stamps") == 0


def pictures_in(bag: Path) -> list[tuple[int, int]]:
    """Stamp and number of each picture of a recording."""
    with BagReader(bag) as reader:
        return [(p.stamp_ns, number_of(p.image)) for p in Frames(reader, IMAGE).pictures()]


@pytest.mark.parametrize("sqlite", [False, True])
@pytest.mark.parametrize("kind", ["twice", "late", "unordered"])
def test_a_frame_keeps_the_stamp_of_the_message_that_it_came_in(
    tmp_path: Path, kind: str, sqlite: bool
) -> None:
    messages = DAY.messages()
    if kind == "twice":
        messages += [m for m in messages if m[0] == "/cam"][::7]
    elif kind == "late":
        messages = [
            (topic, name, ns + 60_000_000 * (topic == "/cam" and i % 3 == 0), message)
            for i, (topic, name, ns, message) in enumerate(messages)
        ]
    else:
        np.random.default_rng(3).shuffle(messages)  # type: ignore[arg-type]
    bag = write_bag(tmp_path / "day", messages, sqlite=sqlite, is_sorted=kind != "unordered")
    assert run(bag, tmp_path / "rec") == 0
    stamps_ns = [DAY.zero_ns + k * DAY.frame_step_ns for k in range(121)]
    assert pictures_in(tmp_path / "rec") == list(zip(stamps_ns, range(121), strict=True))


def test_messages_that_change_their_places_during_the_import_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    bag = write_bag(tmp_path / "day", DAY.messages())
    readings = []
    raw = SourceBag.raw

    def other_order(self: SourceBag, topic: str) -> Iterator[tuple[int, bytes]]:
        found = list(raw(self, topic))
        readings.append(topic)
        if readings.count("/cam") == 2:
            found[5:7] = found[6:4:-1]
        return iter(found)

    monkeypatch.setattr(SourceBag, "raw", other_order)
    said = refused("import-bag", bag, *OPTIONS, "--out", tmp_path / "rec")
    assert "/cam: message 6 has the stamp 1700000000600000000 ns" in said
    assert "1700000000500000000" in said
    assert "let nothing write to the bag" in said


def unset_until(end_s: float, begin_s: float = 0.0) -> list[Message]:
    """The day with orientations that aren't set, and frames of another child, for a while."""

    def changed(m: Message) -> Message:
        if m[0] != "/vut/odom" or not begin_s <= (m[2] - DAY.zero_ns) / NS_PER_S < end_s:
            return m
        p = m[3].pose.pose
        none = replace(p, orientation=replace(p.orientation, w=0.0, z=0.0))
        pose = replace(m[3].pose, pose=none)
        return (*m[:3], replace(m[3], pose=pose, child_frame_id="unset"))

    return [changed(m) for m in DAY.messages()]


def test_what_lies_outside_the_crop_is_not_judged(
    tmp_path: Path, refused: Callable[..., str]
) -> None:
    before = write_bag(tmp_path / "before", unset_until(1.0))
    assert run(before, tmp_path / "rec", "--start", 1.5) == 0
    event, _ = imported(tmp_path / "rec")
    assert event.trigger_s is not None
    behind = write_bag(tmp_path / "behind", unset_until(20.0, 11.0))
    assert run(behind, tmp_path / "cut", "--end", 10.5) == 0
    said = refused("import-bag", before, *OPTIONS, "--out", tmp_path / "all")
    assert "/vut/odom: message 1: the orientation's norm is 0.000, not 1, 0.000 s after" in said
    assert "leave the span out with --start and --end" in said
    inside = write_bag(tmp_path / "inside", unset_until(3.0, 2.0))
    said = refused("import-bag", inside, *OPTIONS, "--start", 1.5, "--out", tmp_path / "all")
    assert "/vut/odom: message 101: the orientation's norm is 0.000" in said


def test_stamps_that_go_back_before_the_crop_are_not_judged(tmp_path: Path) -> None:
    def other_run(m: Message) -> Message:
        if m[0] == "/cam" or m[2] - DAY.zero_ns > NS_PER_S // 2:
            return m
        late = stamp(m[2] - NS_PER_S * (5 + (m[2] // 20_000_000) % 2))
        return (*m[:3], replace(m[3], header=replace(m[3].header, stamp=late)))

    bag = write_bag(tmp_path / "day", [other_run(m) for m in DAY.messages()])
    assert run(bag, tmp_path / "rec", "--start", 1) == 0


def ns_of(times_s: np.ndarray) -> np.ndarray:
    return np.round(times_s * 1e9).astype(np.int64) + 17 * NS_PER_S


@pytest.mark.parametrize("seed", range(30))
def test_a_steady_rate_is_thinned_by_count(seed: int) -> None:
    rng = np.random.default_rng(seed)
    fps = float(rng.choice([5, 9.99, 10, 11, 12.5, 14.985, 18.5, 20, 23.976, 25, 30, 50, 60, 120]))
    times_s = np.arange(200) / fps + rng.uniform(-0.02, 0.02, 200) / fps
    rate_hz = None if seed % 2 else float(rng.uniform(0.5, fps))
    thinned = thin(ns_of(times_s), rate_hz)
    mean_fps = 199 / (times_s[-1] - times_s[0])
    step = keep_every(mean_fps, rate_hz)
    assert thinned.places.tolist() == list(range(0, 200, step))
    assert (thinned.keep_every, thinned.notes) == (step, ())
    assert thinned.rate_hz == pytest.approx(mean_fps / step)


@pytest.mark.parametrize(
    "rates", [(60, 15), (15, 60), (30, 12, 30), (100, 10.5), (60, 5), (25, 10, 50, 10)]
)
def test_a_rate_that_varies_leaves_no_gap_that_it_need_not_have(rates: tuple[float, ...]) -> None:
    steps_s = np.concatenate([np.full(int(2 * fps), 1 / fps) for fps in rates])
    times_s = np.concatenate([[0.0], np.cumsum(steps_s)])
    thinned = thin(ns_of(times_s), None)
    kept_s = times_s[thinned.places]
    assert np.diff(kept_s).max() <= max(0.11, 1 / min(rates)) + 1e-6
    assert len(kept_s) < len(times_s)
    assert "its rate varies" in thinned.notes[0]
    assert times_s[-1] - kept_s[-1] < 0.11


def test_a_camera_of_varying_rate_is_imported_without_such_gaps(tmp_path: Path) -> None:
    fast_then_slow = [k / 40 for k in range(160)] + [4 + k / 14 for k in range(100)]
    others = [m for m in DAY.messages() if m[0] != "/cam"]
    frames: list[Message] = []
    for k, t_s in enumerate(fast_then_slow):
        ns = DAY.zero_ns + round(t_s * 1e9)
        frames.append(("/cam", "sensor_msgs/msg/CompressedImage", ns, jpeg(ns, picture(k % 256))))
    assert run(write_bag(tmp_path / "day", [*others, *frames]), tmp_path / "rec") == 0
    with BagReader(tmp_path / "rec") as reader:
        stamps_s = [p.stamp_ns / NS_PER_S for p in Frames(reader, IMAGE).pictures()]
    assert max(np.diff(stamps_s)) < 0.11


def test_files_that_metadata_does_not_name_are_said_and_without_it_all_are_read(
    tmp_path: Path,
) -> None:
    bag = write_bag(tmp_path / "day", DAY.messages())
    (file,) = bag.glob("*.mcap")
    (bag / "zzz.mcap").write_bytes(file.read_bytes())
    assert run(bag, tmp_path / "rec") == 0
    _, provenance = imported(tmp_path / "rec")
    assert provenance.imported is not None
    assert provenance.imported.states is not None
    said = "zzz.mcap isn't named by metadata.yaml and was left out"
    assert said in provenance.imported.states.notes
    (bag / "zzz.mcap").unlink()
    (bag / "metadata.yaml").unlink()
    assert run(bag, tmp_path / "open") == 0
    event, provenance = imported(tmp_path / "open")
    assert event.trigger_s is not None
    assert provenance.imported is not None
    assert provenance.imported.states is not None
    assert (
        "there is no metadata.yaml: what the folder's files hold was read"
        in provenance.imported.states.notes
    )
