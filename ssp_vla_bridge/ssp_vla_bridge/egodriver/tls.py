"""Files of certificates and keys, read before gRPC takes them: it doesn't say what is wrong."""

from __future__ import annotations

import ssl
from pathlib import Path

from ssp_core.errors import InputError
from ssp_core.files.reading import refuse_named_pipe


def read_certificates(file: str, field: str) -> bytes:
    """Return a file of certificates.

    Args:
        file: its path.
        field: option that names it, for messages.

    Raises:
        InputError: it can't be read, or holds none that is one.
    """
    data = _read(file, field)
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_verify_locations(cafile=file)
    except ssl.SSLError as error:
        raise InputError(
            "holds no certificate that can be read",
            field=field,
            value=file,
            remedy="name a file of certificates in PEM, from -----BEGIN CERTIFICATE----- on",
        ) from error
    return data


def read_pair(certificate: str, key: str) -> tuple[bytes, bytes]:
    """Return the key and the certificates of a server.

    Args:
        certificate: path of its file, behind --tls-certificate.
        key: likewise, behind --tls-key.

    Raises:
        InputError: one of them can't be read, or they don't belong together.
    """
    chain = read_certificates(certificate, "--tls-certificate")
    data = _read(key, "--tls-key")
    try:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(certificate, key, password=_no_password)
    except _EncryptedError as error:
        problem, remedy = "is encrypted", "store it without a passphrase, readable by you alone"
        raise InputError(problem, field="--tls-key", value=key, remedy=remedy) from error
    except ssl.SSLError as error:
        problem = "holds no key that can be read"
        remedy = "name the file of the certificate's private key in PEM"
        if error.reason == "KEY_VALUES_MISMATCH":
            problem = f"isn't the key of the first certificate in {certificate}"
        raise InputError(problem, field="--tls-key", value=key, remedy=remedy) from error
    return data, chain


class _EncryptedError(Exception):
    """The key asks for a passphrase."""


def _no_password() -> str:
    raise _EncryptedError


def _read(file: str, field: str) -> bytes:
    refuse_named_pipe(file)
    try:
        return Path(file).read_bytes()
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise InputError(
            f"can't be read: {why}", field=field, value=file, remedy="name a PEM file"
        ) from error
