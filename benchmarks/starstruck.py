"""How fast Starstruck scenes are made, and how small they are stored, next to the published generator.

Run ``python benchmarks/starstruck.py`` (extra `oracle`). One run prints, each as the median of several
repetitions in this process:

- scenes per second of the published generator (``generate_starstruck_scene`` of
  ``tactile_mnist.starstruck_dataset``), of ours in batches (``sample_scenes`` and ``build_meshes``), of
  ours one by one (``SceneDataset[i].mesh``), and of the same with NumPy (``plain_ways.scenes``);
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
from functools import partial
from pathlib import Path

import numpy as np
import plain_ways
import trimesh
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
    meshes = list(plain_ways.scenes(SCENES))
    works = [_published, _batched, _single, _plain, _plain_trimesh, lambda _: _joined(meshes)]
    works[0](10)
    published_s, batched_s, single_s, plain_s, trimesh_s, joined_s = (
        taken_s / SCENES
        for taken_s in plain_ways.medians_in_turn_s(
            [partial(work, SCENES) for work in works], repeats, time.process_time
        )
    )
    statistic = f"median of {repeats}"
    tell(
        "scene", "the mesh of a scene, 1,000 at a time", batched_s, "s", statistic=statistic,
        published=published_s, plain=(plain_s, "NumPy"), limit=(joined_s, "copy of all meshes into one"),
        target="at least 10",
    )  # fmt: skip
    tell(
        "single", "a scene alone, as trimesh", single_s, "s", statistic=statistic, published=published_s,
        plain=(trimesh_s, "NumPy, `Trimesh(process=False)`"), target="at least 20",
    )  # fmt: skip
    cpu_s, size = _written(repeats)
    million = 1e6 / 3_300
    tell("million", "a million scenes on one core", million * cpu_s / 3600, "core-hours")
    tell("million_bytes", "a million scenes in Parquet", 1e6 * size, "bytes")
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


def _plain(count: int) -> None:
    for _ in plain_ways.scenes(count):
        pass


def _plain_trimesh(count: int) -> None:
    for vertices, faces in plain_ways.scenes(count):
        trimesh.Trimesh(vertices, faces, process=False)


def _joined(meshes: list[tuple[np.ndarray, np.ndarray]]) -> None:
    for arrays in zip(*meshes, strict=True):
        np.concatenate(arrays)


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
