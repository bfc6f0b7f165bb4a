"""Frames of the domains by phase, with plan and driven path on them."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from matplotlib.text import Text

from ssp_core.hashing import sha256_file
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.clients.model_client import InProcessClients
from ssp_eval.evaluate.clients.models import bridge_spec
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.store.results import load_cells
from ssp_eval.figures.moments import CellMoments, cell_moments
from ssp_eval.figures.phases import MOST_CELLS, phase_frames, write_phase_frames
from ssp_eval.figures.style import drawing
from ssp_eval.report.cli import FigureSelection, draw_figures


@pytest.fixture
def campaign(make_bag: Callable[..., Path], tmp_path: Path) -> Path:
    out = tmp_path / "out"
    bags = [make_bag(), make_bag("track", domain="physical")]
    models = [bridge_spec(name) for name in ("constant_velocity", "silent")]
    run_campaign(
        [(bag, None) for bag in bags], models, InProcessClients(), out, CellOptions(), True
    )
    return out


@pytest.fixture
def stories(campaign: Path) -> list[CellMoments]:
    found = [cell_moments(cell, campaign) for cell in load_cells(campaign)]
    return [story for story in found if story is not None and not story.cell.is_control]


def test_phase_frames_have_a_plan_and_the_driven_path_on_them(stories: list[CellMoments]) -> None:
    with drawing():
        figure = phase_frames("cut_in", "constant_velocity", stories)
    shown = {(s.cell.domain, m.label.phase) for s in stories for m in s.moments if m.frames}
    gids = {artist.get_gid() for artist in figure.figure.findobj() if artist.get_gid()}
    assert {gid for gid in gids if gid.startswith("plan-")} == {
        f"plan-{domain}-{phase}" for domain, phase in shown
    }
    assert any(gid.startswith("recorded-") for gid in gids)
    assert "Without scores: synthetic." in figure.caption
    assert "in no input of a model" in figure.caption


def test_times_are_given_to_a_hundredth_and_the_signs_have_a_legend(
    stories: list[CellMoments],
) -> None:
    with drawing():
        figure = phase_frames("cut_in", "constant_velocity", stories)
    told = [text.get_text() for text in figure.figure.findobj(Text)]
    first = {
        (s.cell.domain, m.label.phase): m for s in stories for m in reversed(s.moments) if m.frames
    }
    times = sorted(text for text in told if re.fullmatch(r"\d+\.\d\d s", text))
    assert times == sorted(f"{moment.label.t_s:.2f} s" for moment in first.values())
    assert "✓ allowed   ✗ not allowed   – not said" in told


def test_without_the_camera_s_pose_no_path_is_drawn_and_the_caption_says_so(
    stories: list[CellMoments],
) -> None:
    blind = []
    for story in stories:
        clip = story.cell.facts.clip.model_copy(update={"mount_forward_m": None})
        facts = story.cell.facts.model_copy(update={"clip": clip, "stand_in": True})
        blind.append(replace(story, cell=replace(story.cell, facts=facts)))
    with drawing():
        figure = phase_frames("cut_in", "constant_velocity", blind)
    gids = {artist.get_gid() for artist in figure.figure.findobj() if artist.get_gid()}
    assert not {gid for gid in gids if gid.startswith(("plan-", "recorded-"))}
    assert "Without a known pose of the camera, and so without paths" in figure.caption
    assert "Physical is a software stand-in here, not a vehicle: cut_in / " in figure.caption


def test_phases_alone_write_no_other_figure_and_leave_the_campaign_as_it_is(
    campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = {path: sha256_file(path) for path in (campaign / "frames").iterdir()}
    cells = load_cells(campaign)
    out = tmp_path / "figures"
    draw_figures(FigureSelection(out, None, ("phases",)), [], campaign, cells)
    assert {path.stem for path in out.iterdir()} == {"phases_cut_in_constant_velocity"}
    assert f"{out} (4 files)" in capsys.readouterr().out
    assert {path: sha256_file(path) for path in frames} == frames
    many = [one for one in cells if not one.is_control] * MOST_CELLS
    ((name, why),) = write_phase_frames(campaign, out, many, limit=True).left_out
    assert (name, "--only phases" in why) == ("phases", True)
