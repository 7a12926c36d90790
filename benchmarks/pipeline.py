"""Speed, size and memory of the main job, each as a ratio measured in one run.

::

    python benchmarks/pipeline.py              # everything but memory, some minutes
    python benchmarks/pipeline.py --memory     # peak memory of 2,000 and of all 13,580 digits
    python benchmarks/pipeline.py --digits 100 # more digits against the plain implementation

Digits are compared with the plain implementation of `plain_digit.py`, which needs PyVista and is fastest with
fast-simplification. Loading is compared with `tactile_mnist.SimpleMeshDataset` (extra `oracle`), and with
`datasets` in Arrow format, whose columns become a mesh without further work.
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from tactile_toolkit.run.this_process import keep_memory, limit_threads

limit_threads()
keep_memory()

import numpy as np
from figures import tell
from plain_digit import NAME, plain_row
from plain_ways import medians_in_turn_s

from mnist3d.digit_generation import DigitSetSpec, generate, make_row
from mnist3d.digit_records import PARQUET_STYLE, DigitRow, digit_schema
from mnist3d.sources.synthetic import SyntheticSource

SOURCE = SyntheticSource()
MESH_COLUMNS = ["mesh.vertices", "mesh.faces"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--digits", type=int, default=60, help="digits to compare with the plain ones")
    parser.add_argument(
        "--memory", action="store_true", help="measure peak memory of 2,000 and 13,580 digits"
    )
    options = parser.parse_args()
    if options.memory:
        report_memory()
        return
    report_written(options.digits)
    folder = Path(tempfile.mkdtemp())
    try:
        report_workers(folder)
        report_size(folder / "workers-2-0")
        report_loading(folder / "workers-2-0")
    finally:
        shutil.rmtree(folder)
    report_start()


def median_s(action: Callable[[], object], times: int = 5) -> float:
    seconds = []
    for _ in range(times):
        start_s = time.perf_counter()
        action()
        seconds.append(time.perf_counter() - start_s)
    return statistics.median(seconds)


def report_written(count: int) -> None:
    """Measure the processor time of a proved mesh, written, against the plain implementation, in turns."""
    ids = list(range(0, 13_580, 13_580 // count))[:count]
    spec = DigitSetSpec(SOURCE)
    writers = (partial(written_row, spec), lambda digit_id: plain_row(SOURCE.image(digit_id).pixels))
    for write in writers:
        write(ids[0])
    ours_s, plain_s = zip(
        *([processor_s(write, digit_id) for write in writers] for digit_id in ids), strict=True
    )
    built_s = [solid_s(spec, digit_id) for digit_id in ids]
    what = "a digit drawn, made, proved a solid and written, processor time"
    for name, reduced, target in (
        ("plain", statistics.median, ""),
        ("plain_mean", statistics.mean, "at least 15"),
    ):
        tell(
            name, what, reduced(ours_s), "s",
            statistic=f"{reduced.__name__} of {count:,} digits",
            plain=(reduced(plain_s), f"`plain_digit.py`, {NAME}"),
            limit=(reduced(built_s), "constructor of the solid, `manifold3d`"), target=target,
        )  # fmt: skip
    tell("million", "a million digits on one core", 1e6 * statistics.mean(ours_s) / 3600, "core-hours")
    tell(
        "plain_worst", "the slowest of these digits, in medians",
        max(ours_s) / statistics.median(ours_s), "times", target="at most 5",
    )  # fmt: skip


def written_row(spec: DigitSetSpec, digit_id: int) -> None:
    PARQUET_STYLE.encode(DigitRow.table([make_row(digit_id, spec)], digit_schema()))


def solid_s(spec: DigitSetSpec, digit_id: int) -> float:
    """Return the processor time in which `manifold3d` takes the finished mesh of a digit."""
    import manifold3d

    row = make_row(digit_id, spec)
    mesh = manifold3d.Mesh(np.asarray(row.vertices_m, np.float32), np.asarray(row.faces, np.uint32))
    return processor_s(lambda _: manifold3d.Manifold(mesh).status(), digit_id)


def processor_s(write: Callable[[int], object], digit_id: int) -> float:
    start_s = time.process_time()
    write(digit_id)
    return time.process_time() - start_s


def report_workers(folder: Path) -> None:
    """Two workers against one on the same 1,200 digits, whole runs with the start of the workers."""
    spec = DigitSetSpec(SOURCE, limit=1_200)
    seconds = {1: [], 2: []}
    for turn in range(3):
        for workers in (1, 2):
            out = str(folder / f"workers-{workers}-{turn}")
            start_s = time.perf_counter()
            generate(spec, out, ("train",), workers=workers)
            seconds[workers].append(time.perf_counter() - start_s)
    one_s, two_s = (statistics.median(seconds[workers]) for workers in (1, 2))
    tell(
        "workers", "1,200 digits, whole runs, two workers", two_s, "s", statistic="median of 3",
        plain=(one_s, "one worker"), target="at least 1.8",
    )  # fmt: skip


def report_size(folder: Path) -> None:
    import pyarrow.parquet as pq

    files = sorted((folder / "data").glob("*.parquet"))
    rows = sum(pq.ParquetFile(file).metadata.num_rows for file in files)
    largest = max(
        pq.ParquetFile(file).metadata.row_group(group).total_byte_size
        for file in files
        for group in range(pq.ParquetFile(file).metadata.num_row_groups)
    )
    size = sum(file.stat().st_size for file in files)
    tell("bytes", "a digit in Parquet", size / rows, "bytes", target="at most 60000")
    tell("million_bytes", "a million digits in Parquet", 1e6 * size / rows, "bytes")
    tell("group", "its largest row group, unpacked", largest, "bytes", target="at most 100000000")


def report_loading(folder: Path) -> None:
    """Random access to meshes, and the first pass over a set, next to other loaders of the same folder."""
    import pyarrow.parquet as pq
    import trimesh
    from datasets import load_dataset

    import mnist3d

    os.environ["TACTILE_TOOLKIT_CACHE"] = str(folder.parent / "cache")
    digits = mnist3d.load(str(folder), "train")
    first_s = median_s(lambda: digits[0].mesh, 1)
    order = np.random.default_rng(0).permutation(len(digits)).tolist()
    start_s = time.perf_counter()
    for row in order:
        _ = digits[row].mesh
    cold_s = (time.perf_counter() - start_s) / len(order)
    arrow = load_dataset(str(folder), split="train").select_columns(MESH_COLUMNS).with_format("arrow")
    arrays = [(np.array(digits[row].mesh.vertices), np.array(digits[row].mesh.faces)) for row in order[:100]]
    same = plain_mesh(arrow[order[0]])
    assert np.array_equal(same.vertices, arrays[0][0])
    assert np.array_equal(same.faces, arrays[0][1])

    def plain_meshes() -> None:
        for row in order:
            plain_mesh(arrow[row])

    def constructed() -> None:
        for vertices, faces in arrays:
            trimesh.Trimesh(vertices, faces, process=False)

    def first_pass() -> None:
        table = pq.read_table(folder / "data", columns=MESH_COLUMNS)
        for row in range(len(table)):
            plain_mesh(table.slice(row, 1))

    ours_s, plain_s = (
        taken_s / len(order)
        for taken_s in medians_in_turn_s([partial(load_meshes, digits, order), plain_meshes], 5)
    )
    limit = median_s(constructed, 5) / len(arrays), "constructor of `Trimesh`"
    theirs_s = published_s(folder, order[:40]) or 0.0
    tell("first", "the first mesh of a set", first_s, "s")
    tell(
        "load", "a mesh at random, unpacked before", ours_s, "s", statistic="median of 5 passes",
        published=theirs_s, plain=(plain_s, "`datasets` in Arrow format, `Trimesh(process=False)`"),
        limit=limit, target="at least 300" if theirs_s else "",
    )  # fmt: skip
    unpacked_s = median_s(lambda: pq.read_table(folder / "data", columns=MESH_COLUMNS), 3) / len(order)
    tell(
        "cold", "the same, first pass: unpacks Parquet into the cache", cold_s, "s", statistic="one pass",
        published=theirs_s, plain=(median_s(first_pass, 3) / len(order), "`pyarrow`, in stored order"),
        limit=(unpacked_s, "`pyarrow` unpacks alone"),
    )  # fmt: skip


def plain_mesh(row: Any) -> Any:
    """Return the mesh of a row of Arrow, without the work of `Trimesh` on it."""
    import trimesh

    vertices, faces = (
        row[name].combine_chunks().flatten().flatten().to_numpy().reshape(-1, 3) for name in MESH_COLUMNS
    )
    return trimesh.Trimesh(vertices, faces, process=False)


def published_s(folder: Path, order: list[int]) -> float | None:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import datasets
            import tactile_mnist
    except ImportError as error:
        print(f"not compared with SimpleMeshDataset: {error}")
        return None
    theirs = tactile_mnist.SimpleMeshDataset(datasets.load_dataset(str(folder), split="train"))
    _ = theirs[0].mesh
    return median_s(partial(load_meshes, theirs, order), 3) / len(order)


def load_meshes(digits: Sequence[Any], order: list[int]) -> None:
    """Load meshes one after another, keeping none, as a training loop does."""
    for row in order:
        _ = digits[row].mesh


def report_start() -> None:
    """Whole-process times of the interpreter alone, of the import and of the help page."""
    commands = {
        "python alone": ["-c", "pass"],
        "import mnist3d": ["-c", "import mnist3d"],
        "mnist3d --help": [
            "-c",
            "import sys; sys.argv = ['mnist3d', '--help']; from cli.mnist3d import main; main()",
        ],
    }
    for what, arguments in commands.items():
        target = "" if what == "python alone" else "at most 0.5"
        tell(
            what.replace(" ", "_"),
            f"`{what}`",
            median_s(partial(run_python, arguments), 7),
            "s",
            target=target,
        )


def run_python(arguments: list[str]) -> None:
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)


def report_memory() -> None:
    """Peak of the summed proportional memory of a run's processes, two workers."""
    runs = {"2,000 digits": ["--split", "train", "--limit", "2000"], "13,580 digits": ["--split", "all"]}
    for what, options in runs.items():
        out = tempfile.mkdtemp()
        command = [sys.executable, "-c", "from cli.mnist3d import main; main()", "generate", *options]
        start_s = time.perf_counter()
        process = subprocess.Popen([*command, "--workers", "2", "--quiet", "--out", out])
        peak = Peak(process.pid)
        process.wait()
        peak.stop()
        elapsed_s = time.perf_counter() - start_s
        size = sum(file.stat().st_size for file in Path(out).rglob("*.parquet"))
        shutil.rmtree(out)
        if process.returncode:
            sys.exit(f"{what}: the run ended with exit code {process.returncode}")
        note = f"{elapsed_s:.0f} s, {size / 1e6:.0f} MB written"
        tell(f"memory_{what}", f"peak of the memory of {what}, two workers", peak.bytes, "bytes", note=note)


class Peak:
    """Samples the memory of a process and its descendants ten times a second."""

    def __init__(self, pid: int) -> None:
        self.bytes = 0
        self._pid = pid
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()

    def stop(self) -> None:
        self._done.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._done.wait(0.1):
            self.bytes = max(self.bytes, sum(map(_pss, _family(self._pid))))


def _family(pid: int) -> list[int]:
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:
        return []
    return [pid, *(member for child in children for member in _family(int(child)))]


def _pss(pid: int) -> int:
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) * 1024 for line in lines if line.startswith("Pss:")), 0)


if __name__ == "__main__":
    main()
