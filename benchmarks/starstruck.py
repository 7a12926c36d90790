"""How fast Starstruck scenes are made, and how small they are stored, next to the published generator.

Run ``python benchmarks/starstruck.py`` (extra `oracle`). One run prints, each as the median of several
repetitions in this process:

- scenes per second of the published generator (``generate_starstruck_scene`` of
  ``tactile_mnist.starstruck_dataset``), of ours in batches (``sample_scenes`` and ``build_meshes``), and of
  ours one by one (``SceneDataset[i].mesh``);
- processor seconds of a written data set of 3,300 scenes, in a fresh process from its start to its end;
- Parquet bytes per scene.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

from figures import tell

from starstruck_gen import SceneDataset, SceneSpec, build_meshes, load, sample_scenes
from starstruck_gen.sampling import require_feasible

__all__ = ["main"]

SCENES = 1_000


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeats", type=int, default=5, help="repetitions of each measurement")
    repeats = parser.parse_args().repeats
    require_feasible(SceneSpec(), 0)
    warm = [_published, _batched, _single]
    for work in warm:
        work(10)
    # The three take turns, so that other work on the machine weighs on all of them alike.
    rates = [[_scenes_per_s(work) for work in warm] for _ in range(repeats)]
    _, batched, single = (statistics.median(column) for column in zip(*rates, strict=True))
    ratio = statistics.median(row[1] / row[0] for row in rates)
    ratio_single = statistics.median(row[2] / row[0] for row in rates)
    cpu_s, size = _written(repeats)
    tell(
        "scene",
        "the mesh of a scene, in batches",
        1 / batched,
        "s",
        other=ratio / batched,
        target="at least 10",
    )
    tell(
        "single",
        "a scene alone, as trimesh",
        1 / single,
        "s",
        other=ratio_single / single,
        target="at least 20",
    )
    tell(
        "written",
        "3,300 scenes written, with card and picture, processor time",
        cpu_s,
        "s",
        target="at most 5",
    )
    tell("bytes", "a scene in Parquet", size, "bytes", target="at most 1500")


def _published(count: int) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from tactile_mnist import starstruck_dataset
    for number in range(count):
        # The mean number of distractors and of stars is that of the data set.
        starstruck_dataset.generate_starstruck_scene(number, 1 + number % 3, number // 3 % 6)


def _batched(count: int) -> None:
    build_meshes([scene.placements for scene in sample_scenes(SceneSpec(), "train", 0, 0, count)])


def _single(count: int) -> None:
    scenes = SceneDataset(size=count)
    for number in range(count):
        scenes[number].mesh  # noqa: B018


def _scenes_per_s(work: Callable[[int], None]) -> float:
    start_s = time.process_time()
    work(SCENES)
    return SCENES / (time.process_time() - start_s)


def _written(repeats: int) -> tuple[float, float]:
    """Return processor seconds and Parquet bytes per scene of the whole data set."""
    seconds, size = [], 0.0
    for _ in range(repeats):
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, "-c", "from cli.starstruck import main; main()"]
            command += ["generate", "--quiet", "--workers", "1", "--out", folder]
            before = os.times()
            subprocess.run(command, check=True)
            after = os.times()
            seconds.append(
                after.children_user - before.children_user + after.children_system - before.children_system
            )
            files = list(Path(folder, "data").glob("*.parquet"))
            rows = sum(len(load(folder, split)) for split in ("train", "test"))
            size = sum(file.stat().st_size for file in files) / rows
    return statistics.median(seconds), size


if __name__ == "__main__":
    main()
