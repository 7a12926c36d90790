"""Sets of 50,000 shards, plans of 10^8 rows: seconds, memory, maps and open files, in fresh processes.

::

    python benchmarks/large_sets.py                        # all of it
    python benchmarks/large_sets.py planning_digits        # some of it

The sets are one digit in 50,000 shards, or a hundred small ones in up to 20,000 row groups; their shards are
links to one file: what is measured opens files or lists them, whatever is in them.
"""

from __future__ import annotations

import hashlib
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

SHARDS = 50_000
GROUPS = (200, 2_000, 20_000)
GROUPS_OF_SHARD = 100
ROWS = 10**8
REPORT_ROWS, REPORTS = 3 * 10**6, 1_500
SCENES = 10**9

Measure = Callable[[Path], dict[str, float]]
MEASURES: dict[str, Measure] = {}
MAKERS: dict[str, tuple[str, Callable[[Path], None]]] = {}


def measure(function: Measure, name: str, folder: str, make: Callable[[Path], None]) -> None:
    """Add a function that takes a folder, which is made once for all who name it so, and returns figures."""
    MEASURES[name] = function
    MAKERS[name] = folder, make


def main() -> None:
    names = sys.argv[1:] or list(MEASURES)
    if names[0] == "--child":
        print(json.dumps(MEASURES[names[1]](Path(names[2]))))
        return
    with tempfile.TemporaryDirectory() as scratch:
        for name in names:
            print(report(name, Path(scratch)), flush=True)


def report(name: str, scratch: Path, times: int = 3) -> str:
    """Measure something in fresh processes and return the medians in words."""
    folder_name, make = MAKERS[name]
    folder = scratch / folder_name
    if not folder.exists():
        make(folder)
    environment = os.environ | {"TACTILE_TOOLKIT_CACHE": str(scratch / "cache")}
    command = [sys.executable, __file__, "--child", name, str(folder)]
    runs = [
        json.loads(
            subprocess.run(command, check=True, capture_output=True, text=True, env=environment).stdout
        )
        for _ in range(1 if name.startswith(("planning", "random")) else times)
    ]
    medians = {key: statistics.median(run[key] for run in runs) for key in runs[0]}
    return f"{name}: " + ", ".join(f"{key} {value:,.3g}" for key, value in medians.items())


def fabricate_groups(folder: Path, groups: int) -> None:
    """Make a set of so many row groups of one small digit each, a hundred to a shard."""
    from dataclasses import replace

    import pyarrow as pa

    from mnist3d import SolidSpec
    from mnist3d.digit_generation import DigitGenerator, DigitSetSpec
    from mnist3d.sources.synthetic import SyntheticSource
    from tactile_toolkit.generation import plan_build
    from tactile_toolkit.store import ShardName

    small = SolidSpec(target_vertices=600)
    plan = plan_build(DigitGenerator(DigitSetSpec(SyntheticSource(), small, limit=1)), ("train",))
    rows = pa.concat_tables([plan.tasks[0].make().table] * GROUPS_OF_SHARD).combine_chunks()
    first, *others = [
        folder / ShardName("train", index, groups // GROUPS_OF_SHARD).data_path
        for index in range(groups // GROUPS_OF_SHARD)
    ]
    first.parent.mkdir(parents=True)
    first.write_bytes(replace(plan.style, rows_per_group=1).encode(rows))
    for path in others:
        path.hardlink_to(first)


def fabricate(folder: Path, shards: int) -> None:
    """Make a set of so many shards of one digit, with manifest and report."""
    from dataclasses import replace

    import msgspec
    import pyarrow as pa
    import pyarrow.parquet as pq

    from mnist3d.digit_generation import DigitSetSpec, generate
    from mnist3d.digit_records import REPORT_FILE
    from mnist3d.sources.synthetic import SyntheticSource
    from tactile_toolkit.store import ShardName, open_folder
    from tactile_toolkit.store.manifest import write_manifest
    from tactile_toolkit.store.parquet import REPORT_STYLE

    made = generate(DigitSetSpec(SyntheticSource(), limit=1), folder, ("train",))
    (record,) = made.shards
    names = [ShardName("train", index, shards) for index in range(shards)]
    for name in names:
        (folder / name.data_path).hardlink_to(folder / record.shard.data_path)
    (folder / record.shard.data_path).unlink()
    row = pq.read_table(folder / REPORT_FILE)
    rows = pa.concat_tables([row] * shards).combine_chunks()
    place = row.schema.get_field_index("shard")
    content = REPORT_STYLE.encode(rows.set_column(place, "shard", [[str(name) for name in names]]))
    (folder / REPORT_FILE).write_bytes(content)
    records = tuple(msgspec.structs.replace(record, file=name.data_path) for name in names)
    manifest = replace(made, shards=records, files={REPORT_FILE: hashlib.sha256(content).hexdigest()})
    write_manifest(open_folder(str(folder)), manifest)


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def private_mb() -> float:
    """Memory of this process alone; what it has mapped of the cache the system takes back as it likes."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("RssAnon")) * 1024 / 1e6


def info(folder: Path) -> dict[str, float]:
    """``tactile info`` as a user calls it; memory is that of the command."""
    start_s = time.perf_counter()
    subprocess.run(
        [sys.executable, "-m", "cli", "tactile", "info", str(folder)], check=True, capture_output=True
    )
    elapsed_s, used = time.perf_counter() - start_s, resource.getrusage(resource.RUSAGE_CHILDREN)
    return {"s": elapsed_s, "s of the processor": used.ru_utime + used.ru_stime, "MB": used.ru_maxrss / 1e3}


def load(folder: Path) -> dict[str, float]:
    """``load``, the first mesh, then labels; imports are not counted."""
    import pyarrow.parquet  # noqa: F401

    import mnist3d
    import tactile_toolkit.mesh.records  # noqa: F401

    mnist3d.load  # noqa: B018
    start_s, start_cpu_s = time.perf_counter(), time.process_time()
    digits = mnist3d.load(str(folder), "train")
    _ = digits[0].vertices_m
    first_s, first_cpu_s = time.perf_counter() - start_s, time.process_time() - start_cpu_s
    start_s = time.perf_counter()
    _ = digits.labels
    labels_s = time.perf_counter() - start_s
    return {"s": first_s, "s of the processor": first_cpu_s, "labels s": labels_s, "MB": peak_mb()}


def random_access(folder: Path) -> dict[str, float]:
    """A row of every row group in random order, twice over: medians of all items of a pass, and memory."""
    import numpy as np

    import mnist3d

    digits = mnist3d.load(str(folder), "train")
    _ = digits[0].vertices_m
    figures = {"MB before": private_mb()}
    for turn in ("first", "second"):
        times = []
        for row in np.random.default_rng(1).permutation(len(digits)).tolist():
            start_s = time.process_time()
            _ = digits[row].vertices_m
            times.append(time.process_time() - start_s)
        figures[f"{turn} pass us of the processor"] = 1e6 * statistics.median(times)
        figures[f"{turn} pass MB"] = private_mb()
    figures["maps"] = len(Path("/proc/self/maps").read_text().splitlines())
    figures["open files"] = len(list(Path("/proc/self/fd").iterdir()))
    return figures


def fabricate_reports(folder: Path, rows: int, shards: int) -> None:
    """Write the printability reports of so many finished shards, as they lie before they are merged."""
    import numpy as np
    import pyarrow as pa

    from mnist3d.digit_records import report_table
    from tactile_toolkit.store import ShardName
    from tactile_toolkit.store.parquet import REPORT_STYLE

    rng = np.random.default_rng(1)
    each = rows // shards
    for index in range(shards):
        shard = ShardName("train", index, shards)
        values = {
            pa.string(): lambda: rng.choice(["ok", "not"], each),
            pa.int64(): lambda: rng.integers(1, 9, each),
            pa.float64(): lambda: rng.normal(1000, 100, each),
            pa.bool_(): lambda: rng.random(each) < 0.5,
            pa.list_(pa.string()): lambda: [["thin_wall"] * int(few) for few in rng.random(each) < 0.3],
        }
        given = {"split": [shard.split] * each, "shard": [str(shard)] * each}
        schema = report_table(shard, []).schema
        columns = [pa.array(given.get(field.name, values[field.type]()), field.type) for field in schema]
        path = folder / shard.report_path
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(REPORT_STYLE.encode(pa.Table.from_arrays(columns, schema=schema)))


def merging(folder: Path) -> dict[str, float]:
    """The report of a set, merged from those of its shards, and what the card says of it."""
    import pyarrow.parquet  # noqa: F401

    from mnist3d.digit_card import summarise
    from mnist3d.digit_records import REPORT_FILE
    from tactile_toolkit.store import Manifest, ShardName, open_folder
    from tactile_toolkit.store.manifest import ShardRecord
    from tactile_toolkit.store.parquet import merge_reports

    where, names = open_folder(str(folder)), [ShardName("train", i, REPORTS) for i in range(REPORTS)]
    each, digest = REPORT_ROWS // REPORTS, "0" * 64
    more = {"report_sha256": digest, "unpacked_bytes": 1}
    records = [ShardRecord(name.data_path, name.split, each, 1, digest, **more) for name in names]
    manifest = Manifest("mnist3d", "0", {}, ("train",), tuple(records))
    before_mb, start_s = peak_mb(), time.process_time()
    merge_reports(where, REPORT_FILE, manifest)
    merged_mb, merged_s = peak_mb(), time.process_time() - start_s
    (summary,) = summarise(where, manifest)
    assert sum(summary.facets["label"].values()) == REPORT_ROWS
    card_s = time.process_time() - start_s - merged_s
    return {
        "s of the processor": merged_s,
        "for the card": card_s,
        "MB before": before_mb,
        "MB": merged_mb,
        "MB with card": peak_mb(),
    }


def planning_digits(_: Path) -> dict[str, float]:
    from mnist3d.digit_generation import DigitGenerator, DigitSetSpec
    from mnist3d.digit_options import SplitSpec
    from mnist3d.sources.synthetic import SyntheticSource
    from tactile_toolkit.generation import plan_build

    sizes = (("train", 95 * ROWS // 1000), ("test", ROWS // 1000))
    start_s, start_cpu_s = time.perf_counter(), time.process_time()
    spec = DigitSetSpec(SyntheticSource(count=ROWS), split=SplitSpec(sizes=sizes))
    plan = plan_build(DigitGenerator(spec))
    elapsed_s, cpu_s = time.perf_counter() - start_s, time.process_time() - start_cpu_s
    return {"s": elapsed_s, "s of the processor": cpu_s, "MB": peak_mb(), "shards": len(plan.tasks)}


def planning_scenes(_: Path) -> dict[str, float]:
    from starstruck_gen.scene_dataset import SceneGenerator, SceneSetSpec
    from tactile_toolkit.generation import plan_build

    start_s = time.perf_counter()
    plan = plan_build(SceneGenerator(SceneSetSpec(scenes=(("train", SCENES), ("test", SCENES // 100)))))
    return {"s": time.perf_counter() - start_s, "MB": peak_mb(), "shards": len(plan.tasks)}


for function in (info, load):
    measure(function, function.__name__, "shards", partial(fabricate, shards=SHARDS))
for count in GROUPS:
    measure(
        random_access, f"random_access_{count}", f"groups-{count}", partial(fabricate_groups, groups=count)
    )
measure(merging, "merging", "reports", partial(fabricate_reports, rows=REPORT_ROWS, shards=REPORTS))
for function in (planning_digits, planning_scenes):
    measure(function, function.__name__, "nothing", Path.mkdir)

if __name__ == "__main__":
    main()
