"""``ssp bag``: look into bags, cut, export and repair them, and record.

All verbs but ``record`` take any rosbag2 bag that is stored as MCAP, ours or not.
"""

from __future__ import annotations

import click

from ssp_monitor.bag_cli.check_cli import check_command, recover_command
from ssp_monitor.bag_cli.cut_cli import cut_command
from ssp_monitor.bag_cli.export_cli import export_command
from ssp_monitor.bag_cli.info_cli import info_command
from ssp_monitor.record_cli import record_command


@click.group()
def bag() -> None:
    """Look into bags, cut, export and repair them."""


for command in (
    info_command,
    check_command,
    cut_command,
    export_command,
    recover_command,
    record_command,
):
    bag.add_command(command)
