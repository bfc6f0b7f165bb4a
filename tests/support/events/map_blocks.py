"""The blocks of a library that was read from a map, by their names."""

from __future__ import annotations

from ssp_scenario_manager.maps.block import Block, Library


def blocks(library: Library) -> dict[str, Block]:
    return {block.block_id: block for block in library.blocks}


def only(library: Library, block_id: str) -> Block:
    assert block_id in blocks(library), [b.block_id for b in library.blocks] + list(
        library.rejected
    )
    return blocks(library)[block_id]
