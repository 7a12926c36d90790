"""Threads of Arrow abort about one in a hundred interpreters at exit, so reading must start none."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import trimesh

from tactile_toolkit.mesh import Mesh, PrintReport, write_mesh
from tactile_toolkit.run.runners import ProcessRunner
from tactile_toolkit.store import build, open_folder
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
        "tactile_toolkit.read.shard",
        """
from tactile_toolkit.places import open_place
for shard in open_place(sys.argv[1]).shards("train"):
    groups = range(shard.metadata.num_row_groups)
    assert sum(len(part.table) for group in groups for part in shard.blocks(group)) == len(shard)
    assert len(shard.block(0, 0).table)
""",
    ),
    "report": (
        "tactile_toolkit.read.shard",
        """
from tactile_toolkit.read import Shard
assert len(Shard(sys.argv[1] + "/reports/toy.parquet").read())
""",
    ),
}


@pytest.mark.one_at_a_desk
@pytest.mark.skipif(sys.platform != "linux", reason="threads are counted in /proc")
@pytest.mark.parametrize("what", READS)
def test_reading_starts_no_thread(tmp_path, what):
    build(open_folder(str(tmp_path)), toy_plan())
    module, code = READS[what]
    script = SCRIPT.format(module=module, code=code)
    done = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


# OpenBLAS is loaded with pyarrow, before a command begins; only the threads of manifold3d are left.
CHECKS = """
import os, pathlib, sys
from tests.command_line import call
if sys.argv[1] == "one":
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
assert call("mnist3d", *sys.argv[2:], "--quiet") == 0
print(len(list(pathlib.Path("/proc/self/task").iterdir())))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="threads are counted in /proc")
@pytest.mark.thorough
@pytest.mark.parametrize("words", ["generate --dry-run --limit 1 --out new", "validate ball.stl"])
def test_commands_limit_threads_before_their_first_digit(tmp_path, monkeypatch, words):
    """There are as many threads as if the process may use only one processor."""
    write_mesh(tmp_path / "ball.stl", ball())
    monkeypatch.chdir(tmp_path)
    single = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    environment = os.environ | single | {"PYTHONPATH": str(Path(__file__).parents[3])}
    one, all_of_them = (
        subprocess.run(
            [sys.executable, "-c", CHECKS, processors, *words.split()],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split()[-1]
        for processors in ("one", "all")
    )
    assert all_of_them == one


def threads_of_a_check(_: int) -> tuple[int, int]:
    tasks = Path("/proc/self/task")
    before = len(list(tasks.iterdir()))
    assert PrintReport.of(ball()).is_solid
    return before, len(list(tasks.iterdir()))


def ball() -> Mesh:
    found = trimesh.creation.icosphere(subdivisions=5, radius=0.02)
    return Mesh(found.vertices.astype("float32"), found.faces.astype("int32"))


@pytest.mark.thorough
@pytest.mark.skipif(sys.platform != "linux", reason="threads are counted in /proc")
def test_workers_limit_threads_before_their_first_task():
    counts = list(ProcessRunner(2).run(threads_of_a_check, [0, 1]))
    assert [after - before for before, after in counts] == [0, 0]
