"""Reading pieces of files of the Hub by their fsspec address: failures named as everywhere else."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator

from tactile_toolkit.hub.errors import named_failures

__all__ = ["named_streaming"]

_ADDRESS = re.compile(r"hf://datasets/(?P<repo>[^/@]+/[^/@]+)(?:@(?P<revision>[^/]+))?/.*")


@contextlib.contextmanager
def named_streaming(address: str) -> Iterator[None]:
    """Name the failures of the Hub and the network while one of its files is read in pieces.

    Parameters
    ----------
    address : str
        ``hf://datasets/USER/NAME[@REVISION]/PATH``; with any other address nothing is changed.

    Raises
    ------
    HubError
        The Hub or the network failed.
    """
    match = _ADDRESS.fullmatch(address)
    if match is None:
        yield
        return
    revision = match["revision"].replace("%2F", "/") if match["revision"] else None
    with named_failures(match["repo"], revision, "streaming"):
        yield
