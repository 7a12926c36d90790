"""Limits of the unpacked size of files, and of the cache of unpacked data."""

from __future__ import annotations

import os
import zipfile

from tactile_toolkit.errors import InputError

UNPACKED_VARIABLE = "TACTILE_TOOLKIT_UNPACKED_MIB"
"""Environment variable that raises the limit, in MiB."""

CACHE_LIMIT_VARIABLE = "TACTILE_TOOLKIT_CACHE_MIB"
"""Environment variable that limits the size of unpacked row groups in the cache, in MiB."""

_UNPACKED_MIB = 512  # ten times the largest row of the published data sets, eleven times all MNIST
_CACHE_MIB = 32 << 10

# While they are read, meshes and tables take 5 to 30 times the size of their files in memory.
_USUAL_EXPANSION = 32


def cache_limit_bytes() -> int:
    """Return the limit of the cache of row groups; InputError unless the variable holds an integer."""
    return _limit_bytes(CACHE_LIMIT_VARIABLE, _CACHE_MIB)


def _limit_bytes(variable: str, default_mib: int) -> int:
    named = os.environ.get(variable) or str(default_mib)
    # Eleven digits of MiB are less than 2^63 bytes, the limit of Arrow and file systems.
    if not (named.isascii() and named.isdigit() and len(named) < 12):
        raise InputError(f"{variable} is {named[:40]!r}; expected an integer of MiB, such as {default_mib}")
    return int(named) << 20


def require_unpackable(size_bytes: int, what: str, file_bytes: int = 0) -> None:
    """Raise InputError, which begins with ``what``, if something would unpack to more than the limit.

    ``file_bytes`` is the size of the file, if known: a large file may unpack to 32 times its size.
    """
    limit = max(_limit_bytes(UNPACKED_VARIABLE, _UNPACKED_MIB), _USUAL_EXPANSION * file_bytes)
    if size_bytes > limit:
        needed_mib = -(-size_bytes // (1 << 20))
        raise InputError(
            f"{what} unpacks to {size_bytes:,} bytes; expected at most {limit:,}; nothing was unpacked",
            next=f"if it is meant to be that large, set {UNPACKED_VARIABLE}={needed_mib}",
        )


def require_plain_archive(archive: zipfile.ZipFile) -> None:
    """Raise ValueError unless all files are stored or deflated; others unpack to any size at once."""
    for entry in archive.infolist():
        if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise ValueError(
                f"{entry.filename[:80]!r} is packed by method {entry.compress_type}; expected Deflate"
            )
