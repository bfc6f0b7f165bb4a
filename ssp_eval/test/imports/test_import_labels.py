"""Labels of recordings that others made: their phases are measured as any other's."""

from __future__ import annotations

from pathlib import Path

import pytest
from foreign_recordings import TrackDay, starts, truth, write_bag, write_table, write_video

from ssp_core.cli import main
from ssp_core.files.reading import read_mapping
from ssp_eval.data.labels import load_labels
from ssp_eval.labels.check import response_problems

OBJECTS = ("--vut", "/vut/odom", "--object", "ot1=/ot1/odom:car", "--camera", "/cam")


def test_a_track_days_bag_and_a_video_with_states_are_labelled(
    day: TrackDay, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = write_bag(tmp_path / "day", day.messages())
    track, other = tmp_path / "track", tmp_path / "player"
    named = ("--scenario", "joining", "--site", "boulevard")
    assert (
        main(
            [
                "import-bag",
                str(source),
                *OBJECTS,
                "--domain",
                "physical",
                *named,
                "--out",
                str(track),
            ]
        )
        == 0
    )
    video = write_video(tmp_path / "clip.avi", 101)
    table = write_table(tmp_path / "states.csv", day.states, every=2)
    assert (
        main(
            [
                "import-video",
                str(video),
                "--states",
                str(table),
                "--domain",
                "simulation",
                *named,
                "--out",
                str(other),
            ]
        )
        == 0
    )
    # The conflict is so short that two labels in it would be too near the one in the trigger.
    capsys.readouterr()
    assert main(["labels", "new", str(other), str(track)]) == 1
    told = " ".join(capsys.readouterr().err.split())
    assert "labels of simulation would be 0.180 s apart, less than 0.2 s" in told
    assert "trigger 0.040 s, conflict 0.640 s" in told
    for recording in (other, track):
        # Alone each may have a grid all the same, and it is said what that is.
        assert main(["labels", "new", str(recording)]) == 0
        assert "isn't aligned with the phases" in " ".join(capsys.readouterr().err.split())
        labels = tmp_path / f"{recording.name}.labels.json"
        found = load_labels(labels)
        assert (found.plan, len(found.labels)) == ("clock", 9)
        assert response_problems(found) == []
        measured = read_mapping(tmp_path / f"{recording.name}.labels.proposal.json")["event"]
        assert measured["trigger_s"] == pytest.approx(starts(truth(day))[0], abs=0.1)
        assert measured["resolution_s"] - measured["conflict_s"] == pytest.approx(0.64, abs=0.05)
