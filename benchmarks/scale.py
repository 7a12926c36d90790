"""Many machines and large sets: ratios measured in one run, each as the median of several, after a first one.

::

    python benchmarks/scale.py                 # all rows
    python benchmarks/scale.py --only nodes    # some of them

Rows of Ray need the extra `ray`; they start a cluster of two nodes with one core each on this machine.
That of a store needs the extra `s3` and moto, whose server runs on this machine, too.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import shutil
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path

from tactile_toolkit.run.this_process import limit_threads

limit_threads()

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from figures import tell

from mnist3d.digit_generation import DigitGenerator, DigitSetSpec, generate
from mnist3d.sources.synthetic import SyntheticSource
from tactile_toolkit.generation import plan_build
from tactile_toolkit.run import RayRunner, Runner
from tactile_toolkit.run.runners import InlineRunner, ProcessRunner

ROWS: dict[str, Callable[[], None]] = {}
"""What can be measured; a new row is a function with this decorator, which prints its figures."""


def row(report: Callable[[], None]) -> Callable[[], None]:
    ROWS[report.__name__] = report
    return report


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=ROWS, default=list(ROWS), help="rows to measure")
    for name in parser.parse_args().only:
        lacking = [package for package in NEEDS[name] if find_spec(package) is None]
        if lacking:
            print(f"{name}: not measured, {' and '.join(lacking)} not installed")
            continue
        ROWS[name]()


@row
def nodes() -> None:
    """Two Ray nodes of one core against two local processes: whole runs of 600 digits, in turn."""
    spec = DigitSetSpec(SyntheticSource(), limit=600)
    seconds: dict[str, list[float]] = {"processes": [], "ray": []}
    with ray_cluster(cores=(0, 1, 1)) as address, scratch() as folder:
        runners: dict[str, Runner] = {"processes": ProcessRunner(2), "ray": RayRunner(address)}
        for turn in range(4):
            for name, runner in runners.items():
                out = folder / f"{name}-{turn}"
                start_s = time.perf_counter()
                generate(spec, out, ("train",), workers=runner)
                seconds[name].append(time.perf_counter() - start_s)
        same = digests(folder / "ray-0") == digests(folder / "processes-0")
    local, ray = (statistics.median(values[1:]) for values in seconds.values())
    ratios = [one / other for one, other in zip(seconds["processes"][1:], seconds["ray"][1:], strict=True)]
    assert same, "the bytes differ"
    tell(
        "nodes", "600 digits on two Ray nodes of one core, the same bytes", ray, "s", statistic="median of 3",
        plain=(local, "two local processes"), target="at least 0.93",
        note=f"{min(ratios):.2f} to {max(ratios):.2f} times",
    )  # fmt: skip


@row
def overhead() -> None:
    """What Ray adds to a shard, from many shards that cost nothing, as a share of a shard of digits."""
    plan = plan_build(DigitGenerator(DigitSetSpec(SyntheticSource())), ("train",))
    with scratch() as folder:
        shard_s = median_s(lambda: plan.tasks[0].make(), 3)
        size = plan.tasks[0].size
        count = 2_000
        with ray_cluster(cores=(1,)) as address:
            both: dict[str, list[float]] = {"here": [], "there": []}
            for _ in range(4):
                # The function writes what a shard writes, so that only the way there and back differs.
                runners: dict[str, Runner] = {"here": InlineRunner(), "there": RayRunner(address)}
                for name, runner in runners.items():
                    results = runner.run(Nothing(str(folder)), [plan.tasks[0]] * count)
                    next(results)  # joining the cluster and the start of the worker are not of a shard
                    start_s = time.perf_counter()
                    assert sum(1 for _ in results) == count - 1
                    both[name].append((time.perf_counter() - start_s) / (count - 1))
    here, there = (statistics.median(values[1:]) for values in both.values())
    share = (there - here) / shard_s
    what = f"what Ray adds to a shard of {size} digits, as a share of {shard_s:.1f} s"
    tell("overhead", what, 100 * share, "%", target="at most 2")


@row
def again() -> None:
    """A run over a finished set in a store: what it reads, as a share of the bytes that are there."""
    from tests.s3_server import serve

    spec = DigitSetSpec(SyntheticSource(), limit=400)
    with contextlib.closing(serve()) as servers:
        server = next(servers)
        os.environ.update(server.environment())
        server.make_bucket("lake")
        generate(spec, "s3://lake/digits", ("train",), workers=2)
        size = sum(map(len, server.objects("lake").values()))
        server.traffic.reset()
        start_s = time.perf_counter()
        generate(spec, "s3://lake/digits", ("train",), workers=2)
        elapsed_s = time.perf_counter() - start_s
    read, requests = server.traffic.sent_bytes, server.traffic.requests.total()
    what = f"what a run over a finished set of {size / 1e6:.1f} MB in an S3 store reads of it"
    note = f"{read:,} bytes in {requests} requests, {elapsed_s:.2f} s"
    tell("again", what, 100 * read / size, "%", target="at most 1", note=note)


class Nothing:
    """Does nothing with a task of real size."""

    libraries = ("manifold3d", "numpy", "pillow", "pyarrow", "scikit-image", "scipy")

    def __init__(self, folder: str) -> None:
        self.folder = folder

    def __call__(self, task: object) -> str:
        return self.folder


NEEDS = {"nodes": ("ray",), "overhead": ("ray",), "again": ("s3fs", "moto")}


@contextlib.contextmanager
def ray_cluster(cores: tuple[int, ...]) -> Iterator[str]:
    """Start a node for each number of cores, and give the address of the first."""
    os.environ.update(RAY_USAGE_STATS_ENABLED="0", RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO="0")
    from ray.cluster_utils import Cluster

    settings = {"object_store_memory": 80_000_000, "include_log_monitor": False}
    first = {"num_cpus": cores[0], "include_dashboard": False, "no_monitor": True}
    cluster = Cluster(initialize_head=True, head_node_args=settings | first)
    try:
        for count in cores[1:]:
            cluster.add_node(num_cpus=count, **settings)
        yield cluster.address
    finally:
        cluster.shutdown()


@contextlib.contextmanager
def scratch() -> Iterator[Path]:
    folder = Path(tempfile.mkdtemp())
    try:
        yield folder
    finally:
        shutil.rmtree(folder)


def digests(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def median_s(work: Callable[[], object], times: int = 5) -> float:
    work()
    seconds = []
    for _ in range(times):
        start_s = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start_s)
    return statistics.median(seconds)


if __name__ == "__main__":
    main()
