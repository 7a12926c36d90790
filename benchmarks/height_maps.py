"""How fast environments get their assets: height maps of digits, measured in one run.

python benchmarks/height_maps.py [--assets DIR] [--count 40] [--repeats 7] [--pitch-mm 0.2]

Without --assets, digits are made from the embedded source first.
"""

from __future__ import annotations

import argparse
import os
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

# One core, whatever the machine has.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import numpy as np
from figures import tell
from plain_ways import Rays

import env_assets
from env_assets.mesh_view import HeightMap, top_surface
from mnist3d.digit_records import DigitRecord


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--assets", type=Path)
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--pitch-mm", type=float, default=0.2)
    options = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    with tempfile.TemporaryDirectory() as folder:
        os.environ["TACTILE_TOOLKIT_CACHE"] = f"{folder}/cache"
        per_class = -(-options.count // 10)
        provider = env_assets.AssetProvider(options.assets or folder, generate=True, per_class=per_class)
        digits = list(provider.meshes("mnist3d", "test")[: options.count])
        describe(digits, options.pitch_mm / 1000)
        height_table(digits, options.pitch_mm / 1000, options.repeats)


def describe(digits: Sequence[DigitRecord], pitch_m: float) -> None:
    """Print what is measured."""
    faces = statistics.median(len(digit.faces) for digit in digits)
    vertices = statistics.median(len(digit.vertices_m) for digit in digits)
    maps = [top_surface(digit, pitch_m) for digit in digits]
    rows, columns = (statistics.median(size) for size in zip(*(m.heights_m.shape for m in maps), strict=True))
    print(
        f"{len(digits)} digits, medians: {vertices:,.0f} vertices, {faces:,.0f} faces, "
        f"{rows:.0f} x {columns:.0f} pixels of {1000 * pitch_m:g} mm; one core\n"
    )


def height_table(digits: Sequence[DigitRecord], pitch_m: float, repeats: int) -> None:
    """Print milliseconds per map: made, and by rays onto solids that Embree takes first."""
    made = [best_ms(lambda d=digit: top_surface(d, pitch_m), repeats) for digit in digits]
    maps = [top_surface(digit, pitch_m) for digit in digits]
    differences = abs(by_rays(digits[0], maps[0]) - maps[0].heights_m)
    assert np.nanquantile(differences, 0.98) < 1e-5, "the height maps differ"
    rays = [
        best_ms(lambda d=digit, m=height_map: by_rays(d, m), 3)
        for digit, height_map in zip(digits, maps, strict=True)
    ]
    plain_s = statistics.median(rays) / 1000
    note = f"90 %: {np.percentile(made, 90):.2f} ms, worst {max(made):.2f} ms"
    tell(
        "made", f"height map of a digit, {1000 * pitch_m:g} mm pitch", statistics.median(made) / 1000, "s",
        statistic=f"median of digits, minimum of {repeats}", plain=(plain_s, Rays.name), note=note,
    )  # fmt: skip


def by_rays(digit: DigitRecord, expected: HeightMap) -> np.ndarray:
    """Return the same heights by a ray of Embree at the centre of each pixel."""
    x_m, y_m = np.meshgrid(expected.x_m, expected.y_m)
    rays = Rays(digit.vertices_m, digit.faces)
    return rays.heights_m(x_m.ravel(), y_m.ravel()).reshape(expected.heights_m.shape)


def best_ms(action: Callable[[], object], repeats: int) -> float:
    """Run an action a few times and return the shortest processor time in milliseconds."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        action()
        times.append(time.process_time() - start)
    return min(times) * 1000


if __name__ == "__main__":
    main()
