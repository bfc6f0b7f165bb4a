"""docs/sites.md shows what a site file is: every field with its default, and a working example."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest
import yaml
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from ssp_core.errors import InputError
from ssp_core.files.reading import parse_model
from ssp_core.geometry import point_in_polygon
from ssp_core.run_file.model import Camera, Limits, LinkDisturbance, Look
from ssp_core.run_file.quantities import NUMBER, QUANTITIES
from ssp_core.run_file.values import ObjectId, SiteDatum
from ssp_scenario_manager.compile.compiler import Request, compile_task
from ssp_scenario_manager.maps.site import (
    Polygon,
    Site,
    SiteBlock,
    Strip,
    load_site,
    region_polygon,
    site_library,
)

TEXT = (Path(__file__).resolve().parents[2] / "docs" / "sites.md").read_text()
SECTIONS = {
    "Site": Site,
    "Block": SiteBlock,
    "Strip": Strip,
    "Polygon": Polygon,
    "Datum": SiteDatum,
    "Limits": Limits,
    "Camera": Camera,
    "Look": Look,
    "Disturbance": LinkDisturbance,
}


def shown(field: FieldInfo) -> set[str]:
    """Return the texts that a table may give as a field's default."""
    if field.is_required():
        return {"–"}
    if isinstance(field.default, BaseModel):
        return {"all defaults", "none"}
    if field.default in (None, []):
        return {"none", "two steps of the run"}
    return {str(field.default)}


def test_the_ranges_of_all_units_stand_in_their_table() -> None:
    rows = re.findall(r"^\| `?(\w+)`? \| (-\d+) \| (\d+) \|$", TEXT, re.M)
    known = {**QUANTITIES, "none": NUMBER}
    assert rows == [(end, f"{-one.most:.0f}", f"{one.most:.0f}") for end, one in known.items()]


@pytest.mark.parametrize("title", SECTIONS)
def test_every_field_stands_in_its_table_with_its_default(title: str) -> None:
    (part,) = re.findall(rf"^### {title}$(.*?)(?=^###|\Z)", TEXT, re.M | re.S)
    rows = dict(re.findall(r"^\| `(\w+)` \| ([^|]+) \|", part, re.M))
    fields = {f.alias or name: f for name, f in SECTIONS[title].model_fields.items()}
    assert list(rows) == list(fields)
    for name, field in fields.items():
        assert rows[name] in shown(field), name


def test_every_limit_has_a_plausible_range_which_its_table_gives() -> None:
    (part,) = re.findall(r"^### Limits$(.*?)(?=^###|\Z)", TEXT, re.M | re.S)
    rows = dict(re.findall(r"^\| `(\w+)` \| [^|]+ \| ([^|]+) \|", part, re.M))
    for name, field in Limits.model_fields.items():
        if rows[name] == "–":  # ids of objects
            assert field.annotation == list[ObjectId]
            continue
        low, high = (float(w.replace("π", str(math.pi))) for w in rows[name].split(" to "))
        for bound, beyond in ((low, low - 1e-4), (high, high * 1.001), (None, 1e9)):
            given = {"speed_mps": 10.0, "acceleration_mps2": 5.0}
            if bound is not None:
                assert getattr(Limits(**given | {name: bound}), name) == bound
            with pytest.raises(InputError, match=f"{name}: Input should be"):
                parse_model(Limits, given | {name: beyond}, "site")


def test_the_example_is_a_site_that_an_event_is_compiled_for(tmp_path: Path) -> None:
    (example,) = re.findall(r"```yaml\n(.*?)```", TEXT, re.S)
    file = tmp_path / "mine.site.yaml"
    file.write_text(example)
    site, _ = load_site(str(file))
    (block,) = site_library(site).blocks
    assert isinstance(site.geofence, Polygon)
    fence = region_polygon(site, site.geofence)
    for s_m in (0.5, 200.0, 399.5):
        for l_m in (block.right_edge_m, block.left_edge_m):
            assert point_in_polygon(*block.line.to_map(s_m, l_m), fence)
    assert set(yaml.safe_load(example)) >= {
        n for n, f in Site.model_fields.items() if f.is_required()
    } - {"schema_"}
    task = compile_task(Request(event="cut_in", target="track", site=str(file))).task
    assert task.place.name == "my_track"
    assert task.run.datum == site.datum is not None
