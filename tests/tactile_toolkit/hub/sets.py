"""Two repositories for downloads: a small data set of this toolkit, and one large file."""

from __future__ import annotations

import functools
import io
import json
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from tactile_toolkit.store import build, open_folder
from tests.hub_server import HubServer, hub
from tests.tactile_toolkit.hub.client import run_here, settings
from tests.tactile_toolkit.toy import folder_bytes, toy_plan

__all__ = ["BIG", "CONTENT", "FULL", "NAME", "SHARD", "big_parquet", "fetch", "script", "two_sets"]

NAME = "someone/toy"
BIG = "someone/big"
SHARD = "data/train-00000-of-00001.parquet"


def big_parquet(seed: int = 0, rows: int = 400_000) -> bytes:
    """Return a Parquet file of some MB that cannot be compressed."""
    stream = io.BytesIO()
    numbers = np.random.default_rng(seed).integers(0, 1 << 60, rows)
    pq.write_table(pa.table({"id": numbers}), stream, compression="none", use_dictionary=False)
    return stream.getvalue()


CONTENT = big_parquet()


@functools.cache
def _toy_files() -> dict[str, bytes]:
    with tempfile.TemporaryDirectory() as folder:
        build(open_folder(folder), toy_plan())
        return folder_bytes(Path(folder))


@contextmanager
def two_sets(root: Path) -> Iterator[HubServer]:
    """Serve both repositories."""
    for path, content in _toy_files().items():
        (root / NAME / path).parent.mkdir(parents=True, exist_ok=True)
        (root / NAME / path).write_bytes(content)
    with hub(root) as running:
        running.create(BIG, {"README.md": b"# Big", SHARD: CONTENT})
        yield running


FULL = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (1000000, resource.RLIM_INFINITY))\n"
"""Limits files to 1 MB, a limit of the file system, to simulate a full disk."""

SCRIPT = """
import json
from tactile_toolkit.exchange.download import DownloadPlan
from tactile_toolkit.errors import ToolkitError
try:
    plan = DownloadPlan.of({name!r}, {splits!r}, revision={revision!r}, out={out!r})
    place = plan.run()
    print(json.dumps([place, [file.path for file in plan.missing], plan.leftover, plan.is_done]))
except ToolkitError as error:
    print(json.dumps([error.exit_code, type(error).__name__, str(error)]))
"""


def script(
    name: str = NAME, *splits: str, out: Path | None = None, revision: str | None = None, before: str = ""
) -> str:
    """Return a script that downloads and prints the result or the failure."""
    place = None if out is None else str(out)
    return before + SCRIPT.format(name=name, splits=splits, revision=revision, out=place)


def fetch(server: HubServer | str, home: Path, text: str, token: str | None = None, **more: str) -> list[Any]:
    """Run a download in this process and return what it printed."""
    done = run_here(text, settings(server, home, token, **more), home)
    assert done.returncode == 0, done.stderr
    assert not token or token not in done.stdout + done.stderr
    found: list[Any] = json.loads(done.stdout.splitlines()[-1])
    return found
