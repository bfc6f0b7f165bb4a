"""Forms in which others write map files: namespaces, encodings, packing, units, headings."""

from __future__ import annotations

import bz2
import gzip
import lzma
import math
import zipfile
from pathlib import Path
from typing import Any

import pytest

from ssp_core.errors import InputError
from ssp_scenario_manager.maps import xml_input
from ssp_scenario_manager.maps.load import load_library

Made = Any
Words = Any
NAMESPACE = "http://www.opendrive.org"


def rewritten(path: Path, old: str, new: str) -> Path:
    """The same file with other text."""
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return path


# -- namespaces and encodings ---------------------------------------------------------------------


def test_the_maps_own_namespace_is_read_and_no_other(made: Made, words: Words) -> None:
    plain = load_library(made.road().write()).blocks
    foreign = f'<v:road xmlns:v="http://vendor" id="9"/>{words.to_road("predecessor", "1", "end")}'
    path = made.add(foreign).write()
    rewritten(path, "<OpenDRIVE>", f'<OpenDRIVE xmlns="{NAMESPACE}">')
    assert [b.block_id for b in load_library(path).blocks] == [b.block_id for b in plain]


def test_a_schemas_location_is_no_namespace_of_the_map(made: Made) -> None:
    location = 'xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:schemaLocation="a b"'
    path = rewritten(made.road().write(), "<OpenDRIVE>", f"<OpenDRIVE {location}>")
    assert len(load_library(path).blocks) == 2


def test_elements_under_a_prefix_are_refused(made: Made) -> None:
    path = made.road().write()
    text = path.read_text().replace("</", "</o:").replace("<", "<o:").replace("<o:/o:", "</o:")
    text = text.replace("<o:?xml", "<?xml").replace(
        "OpenDRIVE>", f'OpenDRIVE xmlns:o="{NAMESPACE}">', 1
    )
    path.write_text(text)
    with pytest.raises(InputError, match=r"has a prefix before its elements.*default namespace"):
        load_library(path)


@pytest.mark.parametrize(
    ("encoding", "name"),
    [
        ("utf-8-sig", "Straße"),
        ("ISO-8859-1", "Straße"),
        ("windows-1252", "Straße"),
        ("UTF-16", "道路"),
        ("UTF-8", "道路"),
    ],
)
def test_encodings_that_the_parser_knows(made: Made, encoding: str, name: str) -> None:
    path = made.road(attributes=f'name="{name}"').write()
    told = "UTF-8" if encoding == "utf-8-sig" else encoding
    text = path.read_text().replace("?>", f' encoding="{told}"?>', 1)
    path.write_bytes(text.encode(encoding))
    assert len(load_library(path).blocks) == 2


@pytest.mark.parametrize("encoding", ["GB2312", "GBK", "Big5", "Shift_JIS", "klingon", None])
def test_other_encodings_are_refused_with_the_remedy(made: Made, encoding: str | None) -> None:
    path = made.road(attributes='name="道路"').write()
    text = path.read_text()
    if encoding is not None:
        text = text.replace("?>", f' encoding="{encoding}"?>', 1)
    path.write_bytes(text.encode("utf-8" if encoding == "klingon" else encoding or "gb2312"))
    with pytest.raises(InputError, match="save it as UTF-8"):
        load_library(path)


def test_packed_maps_are_refused_with_the_remedy(made: Made) -> None:
    data = made.road().write().read_bytes()
    packed = {
        "gunzip": gzip.compress(data),
        "bunzip2": bz2.compress(data),
        "unxz": lzma.compress(data),
    }
    for tool, content in packed.items():
        path = made.folder / f"map.{tool}"
        path.write_bytes(content)
        with pytest.raises(InputError, match=f"is packed; unpack it first, as by {tool}"):
            load_library(path)
    archive = made.folder / "map.zip"
    with zipfile.ZipFile(archive, "w") as whole:
        whole.writestr("map.xodr", data)
    with pytest.raises(InputError, match="as by unzip"):
        load_library(archive)


# -- units ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("unit", "remedy"),
    [
        ("kph", "write km/h, which is meant"),
        ("KMH", "write km/h, which is meant"),
        ("kn", "write one of m/s, mph, km/h"),
    ],
)
def test_a_road_with_another_unit_is_left_out_by_name(
    made: Made, words: Words, unit: str, remedy: str
) -> None:
    limit = f'<speed sOffset="0" max="50" unit="{unit}"/>'
    sections = words.section("", words.lane(-1, inner=limit))
    made.road("1").road("2", head=f'<type s="0" type="town">{limit}</type>')
    made.road("3", sections=sections)
    library = load_library(made.write())
    assert [block.block_id for block in library.blocks] == ["road 1 backward", "road 1 forward"]
    why = f"'{unit}' is no unit of speed in OpenDRIVE; {remedy}"
    assert library.faults == (("road 2", why), ("road 3", why))


def test_a_sign_with_another_unit_is_not_drawn(made: Made) -> None:
    sign = '<signal id="1" s="9" t="-4" orientation="+" type="274" value="50" unit="kph"/>'
    path = rewritten(made.road().write(), "</road>", f"<signals>{sign}</signals></road>")
    for block in load_library(path).blocks:
        assert block.scenery == ()
        assert block.notes == ("1 objects or signs of road 1 can't be drawn",)


# -- headings -------------------------------------------------------------------------------------


def test_headings_in_degrees_are_refused(made: Made, words: Words) -> None:
    for geometry in (
        words.at(0, 0, 90, 100),
        words.at(0, 0, 90, 50) + words.at(0, 50, 90, 50, s=50),
        words.at(0, 0, 0, 50) + words.at(50, 0, -45, 50, s=50),
    ):
        made.parts.clear()
        path = made.road(geometry=geometry).write()
        with pytest.raises(InputError, match=r"road 1 / planView / geometry / hdg.*in radians"):
            load_library(path)


def test_roads_in_degrees_that_are_linked_are_refused(made: Made, words: Words) -> None:
    made.road("1", geometry=words.at(0, 0, 0, 100), links=words.to_road("successor", "2", "start"))
    made.road(
        "2", geometry=words.at(100, 0, 90, 100), links=words.to_road("predecessor", "1", "end")
    )
    with pytest.raises(InputError, match=r"road 2 / .*\(got 90\.0\); hdg is in radians"):
        load_library(made.write())


def test_headings_that_are_summed_up_are_read(made: Made, words: Words) -> None:
    """Tools add each turn to the heading before: 7.2 rad, and a road goes on where that leads."""
    ahead = 100 * math.cos(7.2), 100 * math.sin(7.2)
    links = words.to_road("successor", "2", "start"), words.to_road("predecessor", "1", "end")
    made.road("1", geometry=words.at(0, 0, 7.2, 100), links=links[0])
    made.road("2", geometry=words.at(*ahead, 7.2 - 2 * math.pi, 100), links=links[1])
    more = words.at(50 * math.cos(13.2), 200 + 50 * math.sin(13.2), 13.2, 50, s=50)
    made.road("3", geometry=words.at(0, 200, 13.2, 50) + more)
    assert len(load_library(made.write()).blocks) == 6 - 2  # roads 1 and 2 are joined


@pytest.mark.parametrize("heading", [6.2832, -6.28, 3.1415926])
def test_headings_of_at_most_one_turn_are_read(made: Made, words: Words, heading: float) -> None:
    assert load_library(made.road(geometry=words.at(0, 0, heading, 100)).write()).blocks


# -- how far the reading is -----------------------------------------------------------------------


def test_a_map_says_how_many_of_its_roads_are_read(
    made: Made, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = made.road("1").road("2").road("3").write()
    told: list[tuple[int, int | None]] = []
    # Tags lie across the ends of what is read at once.
    monkeypatch.setattr(xml_input, "_CHUNK_BYTES", 7)
    load_library(path, lambda read, total: told.append((read, total)))
    assert told == [(1, 3), (2, 3), (3, 3)]


def test_a_map_whose_encoding_hides_its_tags_says_no_total(made: Made) -> None:
    path = made.road("1").write()
    path.write_bytes(path.read_text().replace("utf-8", "utf-16").encode("utf-16"))
    told: list[tuple[int, int | None]] = []
    load_library(path, lambda read, total: told.append((read, total)))
    assert told == [(1, None)]
