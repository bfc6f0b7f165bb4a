"""The token of the operators' page where people choose it themselves."""

from __future__ import annotations

from ssp_core.errors import InputError

# A token on a command line could be read by every user of the machine.
TOKEN_VARIABLE = "SSP_PAGE_TOKEN"
LEAST_TOKEN = 16


def check_token(token: str, field: str) -> str:
    """The token as it is, when it can be one.

    Args:
        token: as it was given.
        field: where.

    Raises:
        InputError: it is too short, or has characters that no header carries.
    """
    if len(token) < LEAST_TOKEN or not token.isascii() or not token.isprintable() or " " in token:
        raise InputError(
            f"must have {LEAST_TOKEN} printable ASCII characters at least, and no space",
            field=field,
            remedy="leave it out, and one is made",
        )
    return token
