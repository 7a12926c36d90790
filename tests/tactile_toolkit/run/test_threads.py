"""Threads of Arrow's abort about one in a hundred interpreters that end: reading must start none."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from tactile_toolkit.run.processes import InlineRunner
from tactile_toolkit.store.build import build
from tactile_toolkit.store.folder import DataFolder
from tests.tactile_toolkit.toy import toy_plan

SCRIPT = """
import pathlib, sys
import pyarrow.parquet
import {module}
before = len(list(pathlib.Path("/proc/self/task").iterdir()))
{code}
after = len(list(pathlib.Path("/proc/self/task").iterdir()))
assert after == before, f"{{after - before}} threads were started"
"""

READS = {
    "rows": (
        "tactile_toolkit.read.parquet",
        """
from tactile_toolkit.catalog.locate import find_shards
for shard in find_shards(sys.argv[1], "train"):
    groups = range(shard.metadata.num_row_groups)
    assert sum(len(part.table) for group in groups for part in shard.blocks(group)) == len(shard)
    assert len(shard.block(0, 0).table)
""",
    ),
    "report": (
        "tactile_toolkit.store.reports",
        """
from tactile_toolkit.store.folder import DataFolder
assert len(tactile_toolkit.store.reports.read_report(DataFolder(sys.argv[1]), "reports/toy.parquet"))
""",
    ),
}


@pytest.mark.skipif(sys.platform != "linux", reason="threads are counted in /proc")
@pytest.mark.parametrize("what", READS)
def test_reading_starts_no_thread(tmp_path, what):
    build(DataFolder(str(tmp_path)), toy_plan(), InlineRunner())
    module, code = READS[what]
    script = SCRIPT.format(module=module, code=code)
    done = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


LIMITED = """
import pathlib
from tactile_toolkit.run.limits import limit_threads
limit_threads()
import numpy
numpy.ones((500, 500)) @ numpy.ones((500, 500))
print(len(list(pathlib.Path("/proc/self/task").iterdir())))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="threads are counted in /proc")
def test_a_process_that_is_limited_starts_no_threads_for_sums():
    """Machines of one core prove nothing here: their libraries start none by themselves."""
    settings = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run(
        [sys.executable, "-c", LIMITED], env=settings, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "1"
