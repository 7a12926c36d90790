"""How much a file may unpack to: one limit for all kinds, as a few bytes can stand for any number of them."""

from __future__ import annotations

import os

from tactile_toolkit.errors import InputError

__all__ = ["UNPACKED_VARIABLE", "require_unpackable", "unpacked_limit_bytes"]

UNPACKED_VARIABLE = "TACTILE_TOOLKIT_UNPACKED_MIB"
"""Environment variable that raises the limit, in MiB."""

_USUAL_MIB = 512
"""Ten times the largest row of the published data sets, eleven times the images of MNIST."""


def unpacked_limit_bytes() -> int:
    """Return the limit; InputError where the environment variable does not hold a whole number."""
    named = os.environ.get(UNPACKED_VARIABLE) or str(_USUAL_MIB)
    if not (named.isascii() and named.isdigit() and len(named) < 12):
        message = (
            f"{UNPACKED_VARIABLE} is {named[:40]!r}; expected a whole number of MiB, such as {_USUAL_MIB}"
        )
        raise InputError(message)
    return int(named) << 20


def require_unpackable(size_bytes: int, what: str) -> None:
    """Refuse to unpack more than the limit, before it is done; ``what`` it is of begins the InputError."""
    limit = unpacked_limit_bytes()
    if size_bytes > limit:
        needed_mib = -(-size_bytes // (1 << 20))
        message = (
            f"{what} unpacks to {size_bytes:,} bytes; expected at most {limit:,}; nothing was unpacked; "
            f"next: where it is meant to be that large, set {UNPACKED_VARIABLE}={needed_mib}"
        )
        raise InputError(message)
