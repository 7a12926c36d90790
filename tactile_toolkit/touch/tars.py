"""Tars that come from outside: what `tarfile` would believe or pass over is an error here."""

from __future__ import annotations

import tarfile
from collections.abc import Iterator
from typing import IO, Self

_MOST_HEADER_BYTES = 1 << 16
_EXTENDED = (b"x", b"g", b"X", tarfile.GNUTYPE_LONGNAME, tarfile.GNUTYPE_LONGLINK)
"""Headers about the next one; `tarfile` reads all of their content."""


def files_of_tar(stream: IO[bytes], size: int) -> Iterator[tarfile.TarInfo]:
    """Yield the header of each file in a tar of ``size`` bytes; its content lies inside of the tar.

    Raises tarfile.ReadError, which names the member, for a header that is damaged or states what cannot be,
    and for a tar that is cut short.
    """
    name = ""

    class Header(tarfile.TarInfo):
        @classmethod
        def frombuf(cls, buf: bytes | bytearray, encoding: str, errors: str) -> Self:
            nonlocal name
            try:
                header = super().frombuf(buf, encoding, errors)
            except tarfile.HeaderError as error:
                if any(buf):  # else it is the end; a damaged header would be taken for it
                    raise tarfile.ReadError(f"the header after {name!r} cannot be read: {error}") from error
                raise
            name = header.name
            # Reading continues where the content ends, which with a negative size is an earlier header.
            if header.size < 0 or (header.size > _MOST_HEADER_BYTES and header.type in _EXTENDED):
                raise tarfile.ReadError(f"{name!r} has a size of {header.size:,} bytes")
            return header

    try:
        with tarfile.open(fileobj=stream, mode="r:", tarinfo=Header) as tar:
            for member in tar:
                # Of an extended header that states something else than a number, `tarfile` makes 0.
                stated = member.pax_headers.get("size", str(member.size))
                if stated.lstrip("0") != str(member.size).lstrip("0") or member.size < 0 or member.issparse():
                    raise tarfile.ReadError(
                        f"{member.name!r} is sparse, or its size is not a number of bytes"
                    )
                if member.isfile():
                    if member.offset_data + member.size > size:
                        raise tarfile.ReadError(f"it ends in {member.name!r}")
                    yield member
        stream.seek(max(0, size - tarfile.BLOCKSIZE))
        if stream.read().strip(b"\0"):
            raise tarfile.ReadError("the mark of its end is missing")
    except (ValueError, IndexError, RecursionError) as error:  # of what extended headers state
        raise tarfile.ReadError(f"the headers up to {name!r} cannot be read: {error}") from error
