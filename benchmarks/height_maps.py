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
    """Print milliseconds per map: made, and by every-triangle search."""
    made = [best_ms(lambda d=digit: top_surface(d, pitch_m), repeats) for digit in digits]
    boxes = [best_ms(lambda d=digit: by_boxes(d, top_surface(d, pitch_m)), 1) for digit in digits[:8]]
    middle_s, boxes_s = (statistics.median(times) / 1000 for times in (made, boxes))
    note = f"90 %: {np.percentile(made, 90):.2f} ms, worst {max(made):.2f} ms"
    what = f"height map of a digit, {1000 * pitch_m:g} mm pitch; triangle by triangle"
    tell("made", what, middle_s, "s", other=boxes_s, note=note)


def by_boxes(digit: DigitRecord, expected: HeightMap) -> None:
    """The plain way, for comparison: each triangle tried at the pixels of its bounding box, in a loop."""
    window = expected
    heights = np.full(expected.heights_m.shape, -np.inf)
    places = digit.vertices_m.astype(np.float64) / [window.pitch_m, window.pitch_m, 1]
    places[:, :2] -= [window.first_column + 0.5, window.first_row + 0.5]
    for a, b, c in places[digit.faces]:
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area <= 0:
            continue
        low, high = np.ceil(np.min([a, b, c], axis=0)), np.floor(np.max([a, b, c], axis=0))
        columns, rows = np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1)
        x, y = np.meshgrid(columns, rows)
        v = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area
        w = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area
        inside = (v >= -1e-9) & (w >= -1e-9) & (v + w <= 1 + 1e-9)
        place = y[inside].astype(int), x[inside].astype(int)
        heights[place] = np.maximum(heights[place], (a[2] + v * (b[2] - a[2]) + w * (c[2] - a[2]))[inside])
    np.testing.assert_allclose(
        np.where(np.isneginf(heights), np.nan, heights), expected.heights_m, rtol=0, atol=1e-7
    )


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
