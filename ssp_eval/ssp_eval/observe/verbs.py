"""``ssp audit`` and the verbs under it."""

from __future__ import annotations

import importlib
from typing import Any

import click

# verb: (module:function, one line of help); imported when it is used.
VERBS = {
    "observe": (
        "ssp_eval.observe.cli:observe",
        "Look at a recording: make the page, or seal what was seen.",
    ),
    "agree": (
        "ssp_eval.observe.cli:agree_command",
        "Compare two persons' observations of a recording.",
    ),
}


class AuditCommand(click.Command):
    """A command with arguments of its own, and verbs where the first argument names one."""

    def make_context(
        self,
        info_name: str | None,
        args: list[str],
        parent: click.Context | None = None,
        **extra: Any,
    ) -> click.Context:
        if args and args[0] in VERBS:
            module, function = VERBS[args[0]][0].split(":")
            command: click.Command = getattr(importlib.import_module(module), function)
            return command.make_context(f"{info_name} {args[0]}", args[1:], parent, **extra)
        return super().make_context(info_name, args, parent, **extra)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        super().format_options(ctx, formatter)
        with formatter.section("Other commands"):
            formatter.write_dl(
                [(f"{ctx.command_path} {name}", text) for name, (_, text) in VERBS.items()]
            )
