"""A Hub on 127.0.0.1 that the unmodified clients talk to: commits, large files, accounts, faults.

::

    with hub(folder) as server:                      # FOLDER/USER/NAME/... are served as data sets
        token = server.account("someone")            # a token that may write under someone/...
        server.create("someone/digits", {"README.md": b"..."}, private=True)
        server.faults.fail("*/commit/*", 503, times=2)
        ...                                           # run a client with HF_ENDPOINT=server.endpoint
        server.requests                               # every request: method, path, range, bytes both ways

Clients need ``HF_HUB_DISABLE_XET=1``: like most mirrors of the Hub, this one has no Xet storage. Large files
are sent by a second listener, as the Hub leaves them to other hosts.
"""

from __future__ import annotations

from tests.hub_server.faults import Fault, Faults, Request
from tests.hub_server.repositories import Account, Blob, Commit, Repository
from tests.hub_server.server import HubServer, hub

__all__ = ["Account", "Blob", "Commit", "Fault", "Faults", "HubServer", "Repository", "Request", "hub"]
