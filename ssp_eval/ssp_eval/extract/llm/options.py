"""The command line's options for the LLM of the extraction, the same wherever they stand."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from ssp_core import console
from ssp_core.chat import OpenAIChat, Policy
from ssp_core.credentials import check_key, is_http_address
from ssp_core.options import Number
from ssp_eval.extract.llm.extractor import Extractor, make_extractor

Command = TypeVar("Command", bound=Callable[..., Any])
_REMEDIES = {
    "unreachable": "start it, or give the address of another",
    "400": "where the server can't hold answers to a schema, say so with the option for it",
    "401": "name the variable that holds the key",
    "403": "name the variable that holds the key",
    "404": "the model must be one that the server serves, and the address usually ends in /v1",
}


def llm_options(prefix: str = "") -> Callable[[Command], Command]:
    """The options, which reach the command as ``llm`` and ``llm_…`` for extractor_of.

    Args:
        prefix: of the options besides ``--llm``, where a command has another server too.
    """

    def named(name: str) -> str:
        return f"--{prefix}{name}"

    options = [
        click.option("--llm", metavar="MODEL", help="LLM that is asked for slots which the rules "
                     "left empty, as its server names it. Default: rules alone."),
        click.option(named("base-url"), "llm_base_url", metavar="URL",
                     help="Of the LLM's server (OpenAI chat interface), up to and with /v1."),
        click.option(named("api-key-env"), "llm_api_key_env", metavar="VAR",
                     help="Environment variable that holds the key for it."),
        click.option(named("cache"), "llm_cache", metavar="DIR",
                     type=click.Path(path_type=Path, file_okay=False, resolve_path=True),
                     help="Folder that keeps the LLM's answers, so that none is asked for twice."),
        click.option("--llm-timeout", "llm_timeout_s",
                     type=Number(0.1), default=60.0, show_default=True,
                     help="For one answer of the LLM, s."),
        click.option(named("no-schema"), "llm_no_schema", is_flag=True,
                     help="Don't ask the LLM's server to hold answers to a schema."),
    ]  # fmt: skip

    def add(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return add


def extractor_of(
    llm: str | None,
    llm_base_url: str | None,
    llm_api_key_env: str | None,
    llm_cache: Path | None,
    llm_timeout_s: float,
    llm_no_schema: bool,
    default_cache: Path | None = None,
) -> Extractor:
    """The extractor that the options ask for.

    Args:
        llm: model, None: rules alone.
        llm_base_url: of its server.
        llm_api_key_env: variable that holds the key.
        llm_cache: folder for answers.
        llm_timeout_s: for one answer.
        llm_no_schema: don't send a schema.
        default_cache: folder where none is named; None: the user's cache.

    Raises:
        click.UsageError: the options don't go together.
        InputError: the variable holds no key, or the folder can't be made.
    """
    if llm is None:
        if llm_base_url is not None or llm_api_key_env is not None or llm_cache is not None:
            raise click.UsageError("options for an LLM need --llm MODEL")
        return make_extractor()
    if llm_base_url is None:
        raise click.UsageError(f"--llm {llm} needs the address of its server")
    _check_url(llm_base_url)
    key = None
    if llm_api_key_env is not None:
        value = os.environ.get(llm_api_key_env)
        key = check_key(llm_api_key_env, value, "leave the option out where no key is wanted")
    policy = Policy(timeout_s=llm_timeout_s)
    chat = OpenAIChat(llm_base_url, llm, key, policy, console.note, remedies=_REMEDIES)
    folder = llm_cache or default_cache or _user_cache()
    return make_extractor(chat, folder, not llm_no_schema, console.note)


def _check_url(url: str) -> None:
    if not is_http_address(url):
        raise click.UsageError(
            f"{url!r} is no address of a server; give one such as http://localhost:8000/v1"
        )


def _user_cache() -> Path:
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return home / "ssp" / "extraction"
