"""The library of any map or site that a file holds."""

from __future__ import annotations

from pathlib import Path

from ssp_core.errors import InputError
from ssp_scenario_manager.maps import opendrive, sumo
from ssp_scenario_manager.maps.block import Library
from ssp_scenario_manager.maps.opendrive import load_opendrive
from ssp_scenario_manager.maps.rings import with_rings
from ssp_scenario_manager.maps.site import load_site, site_library
from ssp_scenario_manager.maps.sumo import load_sumo_net
from ssp_scenario_manager.maps.xml_input import Loading, outermost, untold

_SITES = (".yaml", ".yml", ".json")


def load_library(path: str | Path, loading: Loading = untold) -> Library:
    """Load the blocks of a map or site, by what the file holds.

    Args:
        path: an OpenDRIVE map, a SUMO network, or a site file.
        loading: called with how many roads of a map were read, and of how many.

    Raises:
        InputError: the file can't be read, is none of these, or is malformed.
    """
    path = Path(path)
    if path.suffix in _SITES:
        site, _ = load_site(str(path))
        return site_library(site, path)
    root = outermost(path).tag
    if root == opendrive.ROOT:
        return with_rings(load_opendrive(path, loading))
    if root == sumo.ROOT:
        return with_rings(load_sumo_net(path, loading))
    raise InputError(
        f"its outermost element is <{root[:40]}>",
        file=path,
        remedy="give an OpenDRIVE map (<OpenDRIVE>), a SUMO network (<net>) or a site file",
    )
