"""Heights of a map's ground, and that the exports tell them where a map has any."""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from ssp_core.errors import InputError
from ssp_core.geometry import Pose2
from ssp_core.run_file.road import CurvePiece
from ssp_scenario_manager.compile.targets.carla import export_carla
from ssp_scenario_manager.compile.targets.map_file import Heights
from ssp_scenario_manager.compile.targets.opendrive import opendrive_map
from ssp_scenario_manager.compile.targets.openscenario import export_openscenario
from ssp_scenario_manager.compile.task import PlaceLink

RISING = '<elevation s="0" a="3" b="0.02" c="0" d="0"/><elevation s="200" a="7" b="0" c="0" d="0"/>'


def hilly(block: Any, elevation: str = RISING) -> str:
    """The block's map with an elevation profile."""
    text = opendrive_map(block, "hill", {}).decode()
    return text.replace("<elevationProfile />", f"<elevationProfile>{elevation}</elevationProfile>")


def test_no_map_and_a_flat_map_are_flat(block_of: Any) -> None:
    for heights in (Heights(None), Heights(opendrive_map(block_of(), "flat", {}).decode())):
        assert heights.is_flat
        assert heights.at((1e6, 1e6)) == 0.0


@pytest.mark.parametrize(
    ("place", "height"),
    [((0.0, 0.0), 3.0), ((100.0, -5.0), 5.0), ((199.0, 7.0), 6.98), ((300.0, 0.0), 7.0)],
)
def test_a_place_has_its_roads_elevation(
    place: tuple[float, float], height: float, block_of: Any
) -> None:
    heights = Heights(hilly(block_of()))
    assert not heights.is_flat
    # Samples are 2 m apart: 1 m at 2 %.
    assert heights.at(place) == pytest.approx(height, abs=0.021)


def test_on_a_bend_the_station_counts(curved_block: Any) -> None:
    heights = Heights(hilly(curved_block))
    for s in (30.0, 150.0, 190.0):
        place = curved_block.line.to_map(s, 4.0)
        assert heights.at(place) == pytest.approx(3.0 + 0.02 * s, abs=0.021)


@pytest.mark.parametrize(
    "shape",
    [
        '<poly3 a="0" b="0" c="0.0001" d="0"/>',
        '<paramPoly3 pRange="normalized" aU="0" bU="400" cU="0" dU="0" aV="0" bV="0" cV="16"'
        ' dV="0"/>',
        '<paramPoly3 pRange="arcLength" aU="0" bU="1" cU="0" dU="0" aV="0" bV="0" cV="0.0001"'
        ' dV="0"/>',
    ],
)
def test_cubics_are_followed(shape: str, block_of: Any) -> None:
    text = hilly(block_of()).replace("<line />", shape)
    assert Heights(text).at((100.0, 1.0)) == pytest.approx(5.0, abs=0.05)


FRONTAGE = """<road id="2" length="400" junction="-1"><planView>
<geometry s="0" x="0" y="{y}" hdg="0" length="400"><line/></geometry></planView>
<elevationProfile><elevation s="0" a="{a}" b="0" c="0" d="0"/></elevationProfile>
<lanes/></road>"""


@pytest.mark.parametrize("y", [-5.0, -1.0, 3.0])
def test_a_place_beside_the_block_has_the_height_of_its_road(block_of: Any, y: float) -> None:
    """A frontage road, or the deck of a bridge over it, may lie nearer to a lane."""
    text = hilly(block_of()).replace("</OpenDRIVE>", FRONTAGE.format(y=y, a=50) + "</OpenDRIVE>")
    block = replace(block_of(), roads=("1",))
    heights = Heights(text, block)
    for place, height in (((1.0, -5.0), 3.0), ((100.0, y), 5.0), ((399.0, 3.0), 7.0)):
        assert heights.at(place) == pytest.approx(height, abs=0.03)
        assert Heights(text).at((place[0], y)) == 50.0
    # Beyond its ends others count.
    assert heights.at((405.0, y)) == 50.0
    # A block that is a part of its road has the height of all of it.
    part = replace(block, line=block.line.section(50.0, 200.0))
    assert Heights(text, part).at((210.0, y)) == pytest.approx(7.0)


def test_a_place_far_from_the_blocks_roads_has_the_height_of_the_nearest_one(block_of: Any) -> None:
    """A car that waits across a ring from the VUT's route was refused, on a road of the map."""
    text = hilly(block_of()).replace("</OpenDRIVE>", FRONTAGE.format(y=60, a=50) + "</OpenDRIVE>")
    heights = Heights(text, replace(block_of(), roads=("1",)))
    assert heights.at((100.0, 61.0)) == 50.0
    with pytest.raises(InputError, match="60 m from the nearest road"):
        heights.at((100.0, 120.0))


def test_a_road_over_itself_has_the_height_of_the_level_that_the_block_is_on(block_of: Any) -> None:
    """A spiral ramp: straight on, and back over itself at a right angle."""
    quarter = 3 * math.pi / 2
    parts = [(0, 0, 0, 0, 100, "<line/>"),
             (100, 100, 0, 0, 30 * quarter, '<arc curvature="0.03333333333333333"/>'),
             (100 + 30 * quarter, 70, 30, -math.pi / 2, 100, "<line/>")]  # fmt: skip
    plan = "".join(
        f'<geometry s="{s}" x="{x}" y="{y}" hdg="{hdg}" length="{length}">{shape}</geometry>'
        for s, x, y, hdg, length, shape in parts
    )
    length = 200 + 30 * quarter
    text = (
        f'<OpenDRIVE><road id="1" length="{length}" junction="-1"><planView>{plan}</planView>'
        '<elevationProfile><elevation s="0" a="0" b="0.05" c="0" d="0"/></elevationProfile>'
        "<lanes/></road></OpenDRIVE>"
    )
    # It crosses itself at x = 70 m: at s = 70 m, and 30 m after the bend.
    lower = replace(block_of([CurvePiece(length_m=100.0)]), roads=("1",))
    upper = replace(
        block_of([CurvePiece(length_m=100.0)], Pose2(70.0, 30.0, -math.pi / 2)), roads=("1",)
    )
    for place in ((70.0, 0.4), (69.8, -0.3)):
        assert Heights(text, lower).at(place) == pytest.approx(3.5, abs=0.06)
        assert Heights(text, upper).at(place) == pytest.approx(
            0.05 * (130 + 30 * quarter), abs=0.06
        )


def test_a_map_with_a_namespace_has_its_heights(block_of: Any) -> None:
    text = hilly(block_of()).replace("<OpenDRIVE", '<OpenDRIVE xmlns="http://x"', 1)
    assert Heights(text).at((100.0, 0.0)) == pytest.approx(5.0, abs=0.021)


def test_a_place_far_from_all_roads_has_no_height(block_of: Any) -> None:
    with pytest.raises(InputError, match="100 m from the nearest road"):
        Heights(hilly(block_of())).at((50.0, -100.0))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<OpenDRIVE><road", "not valid XML"),
        (
            "<OpenDRIVE><road><elevationProfile><elevation a='x'/></elevationProfile></road>"
            "</OpenDRIVE>",
            "elevation> is not a number",
        ),
        (
            "<OpenDRIVE><road><elevationProfile><elevation a='1'/></elevationProfile></road>"
            "</OpenDRIVE>",
            "road> ",
        ),
        ('<!DOCTYPE x [<!ENTITY a "b">]><OpenDRIVE>&a;</OpenDRIVE>', "not valid XML"),
    ],
)
def test_a_broken_map_is_refused(text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        Heights(text)


def test_scenarios_and_configurations_tell_heights(
    case_of: Any, block_of: Any, tmp_path: Path
) -> None:
    place = PlaceLink(kind="opendrive", name="hill.xodr", sha256="sha256:map")
    block = block_of()
    case = case_of("vru_crossing", block, "openscenario", place)
    text = hilly(block)
    files = export_openscenario(case.task, block, text, tmp_path)
    root = ET.parse(files[0]).getroot()
    told = [float(p.get("z", "nan")) for p in root.iter("WorldPosition")]
    # VUT at 15 m, pedestrian at 110 m, its path, and the anchor less the front overhang.
    assert told == pytest.approx([3.3, 5.2, 5.2, 5.2, 5.128], abs=0.021)
    files = export_carla(case.task, block, case.plan, text, tmp_path)
    config = json.loads(files[0].read_text())
    vut, walker = config["actors"]
    assert vut["reference"]["location"]["z"] == pytest.approx(3.3, abs=0.021)
    assert walker["spawn"]["location"]["z"] == pytest.approx(5.2 + 0.975, abs=0.021)
    assert config["conflict"]["z"] == pytest.approx(5.2, abs=0.021)


def test_on_a_flat_map_heights_are_the_players(case_of: Any, tmp_path: Path) -> None:
    case = case_of("vru_crossing")
    files = export_openscenario(case.task, case.block, None, tmp_path)
    assert all(p.get("z") is None for p in ET.parse(files[0]).getroot().iter("WorldPosition"))
