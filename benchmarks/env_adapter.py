"""What our adapter saves the published environments, compared with their `SimpleMeshDataset` on one folder.

::

    python benchmarks/env_adapter.py                 # 300 digits
    python benchmarks/env_adapter.py --digits 1000

Both ways take turns in one process, and each figure is the median of several; needs the extra `env`. A fetch
is what the environment's prefetching thread does for a new episode: ``dataset[index].mesh``.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import statistics
import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("PYOPENGL_PLATFORM", "egl")

import numpy as np
from figures import tell

from mnist3d.digit_generation import DigitSetSpec, generate
from mnist3d.sources.synthetic import SyntheticSource

ENVS = 4
REPEATS = 5


def report_fetching(root: Path, theirs: Any, order: Sequence[int]) -> None:
    """Time a mesh in random order, met for the first time and met again."""
    ours = adapted(root)
    first_us = fetch_us(ours, order)  # also unpacks each row group, once per machine
    theirs_us, ours_us = medians(lambda: fetch_us(theirs, order), lambda: fetch_us(ours, order))
    theirs_s = theirs_us / 1e6
    what = "fetching a mesh as the environments do, random order; `SimpleMeshDataset`"
    tell("fetch", what, ours_us / 1e6, "s", other=theirs_s, target="at least 20")
    tell("first", "the same, first pass: unpacks Parquet into the cache", first_us / 1e6, "s", other=theirs_s)


def report_resetting(root: Path, theirs: Any) -> None:
    """Time the reset of four environments: a mesh each, its picture, and a first touch."""
    import tactile_mnist

    import env_assets

    env_id = "TactileMNIST-Depth-train-v0"
    ours_env = env_assets.make(env_id, provider=env_assets.AssetProvider(root), num_envs=ENVS)
    config = tactile_mnist.TactilePerceptionConfig(theirs, **published_settings(env_id))
    theirs_env = tactile_mnist.TactileClassificationVectorEnv(config, ENVS)
    for env in (theirs_env, ours_env):
        env.reset(seed=0)
    theirs_s, ours_s = medians(lambda: reset_s(theirs_env), lambda: reset_s(ours_env))
    tell("reset", f"resetting {ENVS} environments; published", ours_s, "s", other=theirs_s)
    theirs_env.close()
    ours_env.close()


def report_statistics(root: Path, theirs: Any) -> None:
    """Time the statistics of volumes, which the package computes when it first sees a data set."""
    from tactile_mnist import tactile_volume_estimation_env, util

    ours = adapted(root)
    extract = tactile_volume_estimation_env._compute_object_volume_idx

    def statistics_s(dataset: Any) -> float:
        with tempfile.TemporaryDirectory() as cache:
            util.CACHE_BASE_DIR = Path(cache)
            start_s = time.perf_counter()
            with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
                util.get_dataset_stats(dataset, "volume", extract)
            return time.perf_counter() - start_s

    theirs_s, ours_s = medians(lambda: statistics_s(theirs), lambda: statistics_s(ours))
    tell("statistics", f"their statistics of {len(ours)} volumes; published", ours_s, "s", other=theirs_s)


def fetch_us(dataset: Any, order: Sequence[int]) -> float:
    """Return microseconds a mesh."""
    start_s = time.perf_counter()
    for index in order:
        _ = dataset[index].mesh
    return (time.perf_counter() - start_s) / len(order) * 1e6


def reset_s(env: Any) -> float:
    """Return the seconds that one reset takes; seeded again, so that no mesh was fetched beforehand."""
    start_s = time.perf_counter()
    env.reset(seed=int(start_s * 1e6) % 2**31)
    return time.perf_counter() - start_s


def medians(one: Callable[[], float], other: Callable[[], float]) -> tuple[float, float]:
    """Run two ways in turns."""
    pairs = [(one(), other()) for _ in range(REPEATS)]
    first, second = (statistics.median(times) for times in zip(*pairs, strict=True))
    return first, second


def adapted(root: Path) -> Any:
    """Open the folder through a provider and the adapter."""
    import env_assets

    provider = env_assets.AssetProvider(root)
    return env_assets.as_mesh_dataset(provider.meshes("mnist3d", "train"))


def published(root: Path) -> Any:
    """Open the folder with the package's own class, as its registered environments do."""
    import datasets
    import tactile_mnist

    datasets.disable_progress_bars()
    rows = datasets.load_dataset(str(root / "mnist3d"), split="train", cache_dir=str(root / "datasets"))
    return tactile_mnist.SimpleMeshDataset(rows)


def published_settings(env_id: str) -> dict[str, Any]:
    """Return the settings that the package registers."""
    import gymnasium

    settings: dict[str, Any] = gymnasium.spec(env_id).kwargs["default_config"]
    return settings


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--digits", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as temporary:
        root = Path(temporary)
        os.environ["TACTILE_TOOLKIT_CACHE"] = str(root / "cache")
        spec = DigitSetSpec(SyntheticSource(), per_class=options.digits // 10)
        generate(spec, str(root / "mnist3d"), ("train",))
        order = np.random.default_rng(options.seed).permutation(options.digits // 10 * 10).tolist()
        theirs = published(root)
        report_fetching(root, theirs, order)
        report_resetting(root, theirs)
        report_statistics(root, theirs)


if __name__ == "__main__":
    main()
