"""The command line's options for the extraction's reader and LLM, the same wherever they stand."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import reduce
from pathlib import Path
from typing import Any, TypeVar

import click

from ssp_core import console
from ssp_core.chat.client import OpenAIChat, Policy
from ssp_core.credentials import check_key, is_http_address
from ssp_core.options import Number
from ssp_eval.extract.combined.extractor import Extractor

Command = TypeVar("Command", bound=Callable[..., Any])
_SCHEMA_REMEDY = "where the server can't hold answers to a schema, say so with the option for it"
_REMEDIES = {
    "unreachable": "start it, or give the address of another",
    "400": _SCHEMA_REMEDY,
    "option": _SCHEMA_REMEDY,
    "length": "give a model with a longer context, or serve this one with it",
    "401": "name the variable that holds the key",
    "403": "name the variable that holds the key",
    "404": "the model must be one that the server serves, and the address usually ends in /v1",
}


def llm_options(prefix: str = "") -> Callable[[Command], Command]:
    """Return the options, which reach the command as ``llm`` and ``llm_…`` for extractor_of.

    Args:
        prefix: of the options besides ``--llm``, where a command has another server too.
    """
    options = [
        click.option(
            "--rules-only",
            "rules_only",
            is_flag=True,
            help="Read texts by the rules alone, without the learned reader that fills "
            "what they leave empty.",
        ),
        click.option(
            "--llm",
            metavar="MODEL",
            help="LLM that is asked for slots that are still empty, by its name on the server. "
            "Default: none.",
        ),
        click.option(
            f"--{prefix}base-url",
            "llm_base_url",
            metavar="URL",
            help="Address of the LLM's server (OpenAI chat interface), up to and with /v1.",
        ),
        click.option(
            f"--{prefix}api-key-env",
            "llm_api_key_env",
            metavar="VAR",
            help="Environment variable with its key.",
        ),
        click.option(
            f"--{prefix}cache",
            "llm_cache",
            metavar="DIR",
            type=click.Path(path_type=Path, file_okay=False, resolve_path=True),
            help="Folder for the LLM's answers, so that none is asked for twice.",
        ),
        click.option(
            "--llm-timeout",
            "llm_timeout_s",
            type=Number(0.1),
            default=60.0,
            show_default=True,
            help="Time limit for one answer of the LLM, s.",
        ),
        click.option(
            f"--{prefix}no-schema",
            "llm_no_schema",
            is_flag=True,
            help="Don't ask the LLM's server to hold answers to a schema.",
        ),
    ]

    return lambda command: reduce(lambda found, option: option(found), reversed(options), command)


def extractor_of(
    rules_only: bool,
    llm: str | None,
    llm_base_url: str | None,
    llm_api_key_env: str | None,
    llm_cache: Path | None,
    llm_timeout_s: float,
    llm_no_schema: bool,
    default_cache: Path | None = None,
) -> Extractor:
    """Return the extractor that the options ask for; its answers go to the user's cache by default.

    Raises:
        click.UsageError: the options don't go together.
        InputError: the variable holds no key, or the folder can't be made.
    """
    if llm is None:
        if llm_base_url is not None or llm_api_key_env is not None or llm_cache is not None:
            raise click.UsageError("options for an LLM need --llm MODEL")
        return Extractor(use_reader=not rules_only)
    if llm_base_url is None:
        raise click.UsageError(f"--llm {llm} needs the address of its server")
    if not is_http_address(llm_base_url):
        raise click.UsageError(
            f"{llm_base_url!r} is no address of a server; give one such as http://localhost:8000/v1"
        )
    key = None
    if llm_api_key_env is not None:
        value = os.environ.get(llm_api_key_env)
        key = check_key(llm_api_key_env, value, "leave the option out where no key is wanted")
    policy = Policy(timeout_s=llm_timeout_s)
    chat = OpenAIChat(llm_base_url, llm, key, policy, console.note, remedies=_REMEDIES)
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = llm_cache or default_cache or home / "ssp" / "extraction"
    return Extractor(chat, folder, not llm_no_schema, console.note, not rules_only)
