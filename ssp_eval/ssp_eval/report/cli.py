"""``ssp report``: the page of a campaign."""

from __future__ import annotations

from pathlib import Path

import click

from ssp_core import console
from ssp_eval.report.page import write_report


@click.command()
@click.argument("out_dir", type=click.Path(path_type=Path))
def report(out_dir: Path) -> None:
    """Writes OUT_DIR/index.html: one file with the pictures in it, readable offline."""
    with console.progress("pictures", None) as bar:
        task = bar.task_ids[0]
        target = write_report(out_dir, lambda done, of: bar.update(task, completed=done, total=of))
    size_mb = target.stat().st_size / 1e6
    click.echo(f"{target} ({size_mb:.1f} MB)")
