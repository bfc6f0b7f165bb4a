"""OpenDRIVE maps that are malformed or too large: an error names file and element."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from ssp_core.errors import InputError
from ssp_scenario_manager.maps import xml_input
from ssp_scenario_manager.maps.load import load_library

Made = Any
Words = Any


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('length="100.0" junction', 'length="-5" junction', "road 1 / length: is out of bounds"),
        ('length="100.0" junction', "junction", "road 1: has no attribute 'length'"),
        ('length="100.0"><line', 'length="-1"><line', r"geometry\[0\] / length: is out of bounds"),
        ('x="0"', 'x="inf"', r"road 1 / planView\[0\] / geometry\[0\] / x: is not finite"),
        ('hdg="0"', 'hdg="north"', r"geometry\[0\] / hdg: is not a number \(got 'north'\)"),
        ("<line/>", "", r"geometry\[0\]: has no shape"),
        ("<line/>", "<nurbs/>", "unknown shape nurbs"),
        ("<line/>", "<arc/>", r"arc\[0\]: has no attribute 'curvature'"),
        ("<line/>", '<spiral curvStart="0" curvEnd="x"/>', "curvEnd: is not a number"),
        ("<line/>", '<paramPoly3 pRange="km"/>', "has no attribute 'aU'"),
        ('s="0.0"', 's="-1"', r"laneSection\[0\] / s: is out of bounds"),
        ('a="3.5"', 'a="1e99"', "a: is out of bounds"),
        ('<lane id="-1"', '<lane id="-1.5"', "id: is not a whole number"),
        ('<lane id="-1"', '<lane id="-2"', "leaves a lane id out"),
        ('<lane id="-1"', '<lane id="4"', "stands on the right"),
        ('<road id="1"', "<road", "road: has no attribute 'id'"),
        ("<link>", '<link><successor elementType="moon"/>', "elementType: is unknown"),
        ("<link>", '<link><successor elementType="road"/>', "has no attribute 'elementId'"),
        (
            "<link>",
            '<link><successor elementId="1" contactPoint="middle"/>',
            "contactPoint: is no end of a road",
        ),
        (
            "</OpenDRIVE>",
            '<junction id="1"><connection id="0"/></junction></OpenDRIVE>',
            r"junction 1 / connection 0: has no attribute 'incomingRoad'",
        ),
        ("OpenDRIVE", "osm", "outermost element is <osm>"),
    ],
)
def test_malformed_maps_name_file_and_element(made: Made, old: str, new: str, message: str) -> None:
    path = made.road().write()
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=message) as caught:
        load_library(path)
    assert caught.value.file == str(path)


def test_two_roads_with_one_id(made: Made) -> None:
    with pytest.raises(InputError, match=r"road 1 / id: has the id of another road"):
        load_library(made.road().road().write())


def test_records_out_of_order(made: Made, words: Words) -> None:
    sections = words.section("", words.lane(-1), 50.0) + words.section("", words.lane(-1), 0.0)
    with pytest.raises(InputError, match=r"laneSection\[1\] / s: starts before the one ahead"):
        load_library(made.road(sections=sections).write())


def test_a_road_without_lane_sections(made: Made) -> None:
    library = load_library(made.road(sections="").write())
    assert library.rejected == (("road 1", "it has no lane section"),)


def test_a_map_without_roads(made: Made) -> None:
    with pytest.raises(InputError, match="has no road"):
        load_library(made.write())


BOMB = (
    '<!DOCTYPE a [<!ENTITY a "x"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">'
    '<!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;">]>'
)


@pytest.mark.parametrize(
    "declaration", [BOMB, '<!DOCTYPE a [<!ENTITY a SYSTEM "file:///etc/hostname">]>']
)
def test_entities_are_refused(made: Made, declaration: str) -> None:
    path = made.road().write()
    text = path.read_text()
    head, body = text.split("?>", 1)
    path.write_text(f"{head}?>{declaration}{body}".replace("<line/>", "<line/>&c;", 1))
    with pytest.raises(InputError, match="declares entities"):
        load_library(path)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "is not valid XML"),
        (b"\x00\x01\x02", "is not valid XML"),
        (b'<?xml version="1.0" encoding="klingon"?><OpenDRIVE/>', "is not valid XML"),
        (b'<?xml version="1.0" encoding="utf-16"?><OpenDRIVE/>', "is not valid XML"),
        (b"<OpenDRIVE" + b' a="1"' * 2 + b"/>", "is not valid XML"),
    ],
)
def test_files_that_are_no_xml(tmp_path: Path, data: bytes, message: str) -> None:
    path = tmp_path / "map.xodr"
    path.write_bytes(data)
    with pytest.raises(InputError, match=message):
        load_library(path)


def test_files_that_cant_be_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="can't be read: No such file"):
        load_library(tmp_path / "gone.xodr")
    with pytest.raises(InputError, match="is no file"):
        load_library(tmp_path)
    with pytest.raises(InputError):
        load_library("map\x00.xodr")


def test_sizes_are_bounded(made: Made, monkeypatch: pytest.MonkeyPatch) -> None:
    path = made.road().write()
    deep = path.read_text().replace("<line/>", "<line>" + "<a>" * 100 + "</a>" * 100 + "</line>")
    nested = made.folder / "deep.xodr"
    nested.write_text(deep)
    with pytest.raises(InputError, match="nested more than 64 deep"):
        load_library(nested)
    monkeypatch.setattr(xml_input, "MAX_PART_ELEMENTS", 5)
    with pytest.raises(InputError, match="more than 5 elements"):
        load_library(path)
    monkeypatch.setattr(xml_input, "MAX_MAP_BYTES", 10)
    with pytest.raises(InputError, match="at most 0 MiB"):
        load_library(path)


def test_too_many_records_and_lanes(made: Made, words: Words) -> None:
    many = "".join(words.at(0, 0, 0, 0.01) for _ in range(10_001))
    with pytest.raises(InputError, match="is one of 10001; at most 10000"):
        load_library(made.road(geometry=many).write())
    made.parts.clear()
    wide = words.section("", "".join(words.lane(-1 - i) for i in range(65)))
    with pytest.raises(InputError, match="has 65 lanes; at most 64"):
        load_library(made.road(sections=wide).write())


def test_a_huge_road_doesnt_hang(made: Made, words: Words) -> None:
    widths = "".join(f'<width sOffset="{i * 0.05}" a="3.5" b="0.001"/>' for i in range(2000))
    sections = "".join(
        words.section("", words.lane(-1, widths) + words.lane(-2, widths), s * 0.5)
        for s in range(20)
    )
    library = load_library(made.road(sections=sections).write())
    assert library.blocks
