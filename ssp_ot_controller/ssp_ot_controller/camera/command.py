"""Commands of the camera that are run as modules, beside those of ``ssp``."""

from __future__ import annotations

import click

from ssp_core import console
from ssp_core.errors import SspError


def run_command(command: click.Command, module: str) -> int:
    """Runs a module's command line and returns its exit status.

    Args:
        command: of the module.
        module: its name, as ``python -m`` takes it.
    """
    try:
        command.main(prog_name=f"python -m {module}", standalone_mode=False)
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except SspError as error:
        console.report_error(str(error))
        return 1
    return 0
