"""Speed, accuracy and size of the solids: the fast algorithm against the literal one, measured in one run.

python benchmarks/solid.py [--digits ../shared/digits/png] [--count 24 | --all] [--repeats 3]
python benchmarks/solid.py --peer [--count 24 | --all]    # processor time, against plain libraries
"""

from __future__ import annotations

import argparse
import io
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from tactile_toolkit.run import prepare_batch_process

prepare_batch_process()

import numpy as np
import trimesh
from scipy import ndimage
from skimage.filters import threshold_otsu
from skimage.measure import marching_cubes

from mnist3d.digit_options import SolidSpec
from mnist3d.digit_records import PARQUET_STYLE, DigitRow, digit_schema
from mnist3d.ink.binarisation import binarise, count_bodies_and_holes
from mnist3d.solid.algorithm import literal_solid, solidify
from tactile_toolkit.mesh import MM_PER_M, Mesh, PrintProfile, PrintReport

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from tests.mnist3d.surface_distances import symmetric_distances_mm

SPEC, PROFILE = SolidSpec(), PrintProfile()
T, R = TypeVar("T"), TypeVar("R")
DIGITS = Path(__file__).resolve().parents[2] / "shared" / "digits" / "png"


def main() -> None:
    """Print tables of time, accuracy and size, or with ``--peer`` one of processor times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--digits", type=Path, default=DIGITS)
    parser.add_argument("--count", type=int, default=24)
    parser.add_argument("--all", action="store_true")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--points", type=int, default=5000)
    parser.add_argument("--peer", action="store_true")
    options = parser.parse_args()
    paths = sorted(options.digits.glob("*.png"))
    if not options.all:
        paths = paths[:: max(1, len(paths) // options.count)]
    images = [read_grey(path) for path in paths]
    print(f"{len(images)} digits of {options.digits}\n")
    if options.peer:
        peer_table(images)
        return
    time_table(images[:: max(1, len(images) // 24)], options.repeats)
    accuracy_table(images, options.points)


def read_grey(path: Path) -> np.ndarray:
    """Read an image file as grey levels, shape (H, W) uint8."""
    from PIL import Image

    with Image.open(path) as image:
        return np.asarray(image.convert("L"))


def time_table(images: list[np.ndarray], repeats: int) -> None:
    """Print milliseconds per validated mesh, median over digits of the best repeat."""
    spec = SolidSpec()
    fast = [best_ms(lambda p=p: solidify(p, spec), repeats) for p in images]
    meshes = [solidify(p, spec) for p in images]
    checked = [best_ms(lambda m=m: PrintReport.of(m), repeats) for m in meshes]
    literal = [best_ms(lambda p=p: solidify(p, spec, method="literal"), 1) for p in images]
    masks = [binarise(p, spec) for p in images]
    undecimated = [best_ms(lambda m=m: literal_solid(m, spec, decimated=False), 1) for m in masks]
    check, quick = statistics.median(checked), statistics.median(fast)
    print("ms per digit (median)           make   check   total")
    for name, times in (("fast", fast), ("literal", literal), ("literal, not decimated", undecimated)):
        made = statistics.median(times)
        ratio = (made + check) / (quick + check)
        print(f"{name:28s} {made:8.1f} {check:7.1f} {made + check:7.1f}   {ratio:6.1f} x")
    print()


def plain_literal(pixels: np.ndarray) -> Mesh:
    """Make a digit by Algorithm 1 as it is printed, with the usual libraries alone.

    Twenty erosions of the full picture (SciPy), stack, mirror, marching cubes (scikit-image), smoothing
    (trimesh), decimation to as many triangles as ours (fast-simplification). It proves nothing: the mesh is
    not always closed.
    """
    ink = np.pad(pixels <= threshold_otsu(pixels), 1)
    radii_px = 20 - np.sqrt(20**2 - (np.arange(20) + 0.5) ** 2)
    layers = [ndimage.distance_transform_edt(ink) >= radius_px + 0.5 for radius_px in radii_px]
    half = np.stack(layers, axis=2)
    volume = np.pad(np.concatenate([half[:, :, ::-1], half], axis=2), 1).astype(np.float32)
    vertices_px, faces, _, _ = marching_cubes(volume, 0.5, gradient_direction="ascent")
    mesh = trimesh.Trimesh(vertices_px * 0.0002, faces, process=False)
    trimesh.smoothing.filter_taubin(mesh, iterations=20)
    mesh = mesh.simplify_quadric_decimation(face_count=10_000)
    return Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int32))


def our_row(pixels: np.ndarray) -> DigitRow:
    """Make, prove and measure a digit."""
    mesh = solidify(pixels, SPEC)
    report = PrintReport.of(mesh, PROFILE)
    volume_m3 = report.volume_mm3 * 1e-9
    return DigitRow(
        0, 0, mesh.vertices_m, mesh.faces, writer=-1, volume_m3=volume_m3, source="", report=report
    )


def our_shard(rows: list[DigitRow]) -> None:
    """Write rows as `mnist3d generate` does."""
    PARQUET_STYLE.encode(DigitRow.table(rows, digit_schema()))


def peer_table(images: list[np.ndarray]) -> None:
    """Print processor times, digit by digit in turns, in a process of one thread as workers are.

    All digits of a method are written into one file, as in data sets, and each gets its share of the time; a
    file for each of our digits would take 1.2 ms more.
    """
    methods: Any = ((our_row, our_shard), (plain_literal, parquet_bytes))
    for make, write in methods:
        write([make(images[0])] * len(images))
    turns = [[processor_ms(make, pixels) for make, _ in methods] for pixels in images]
    ours_ms, peer_ms = (
        np.array([time_ms for time_ms, _ in results])
        + processor_ms(write, [digit for _, digit in results])[0] / len(images)
        for results, (_, write) in zip(zip(*turns, strict=True), methods, strict=True)
    )
    for name, average in (("mean", np.mean), ("median", np.median)):
        ours, peer = average(ours_ms), average(peer_ms)
        print(f"{name:8s} ours {ours:7.1f} ms   literal {peer:7.1f} ms   {peer / ours:6.1f} x")
    print(f"slowest digit: {ours_ms.max() / np.median(ours_ms):.1f} medians")


def processor_ms(function: Callable[[T], R], argument: T) -> tuple[float, R]:
    """Return the processor time of a call, milliseconds, and its result."""
    start = time.process_time()
    result = function(argument)
    return (time.process_time() - start) * 1000, result


def best_ms(action: Callable[[], object], repeats: int) -> float:
    """Run an action a few times and return the shortest time in milliseconds."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        action()
        times.append(time.perf_counter() - start)
    return min(times) * 1000


def accuracy_table(images: list[np.ndarray], points: int) -> None:
    """Print how far the fast surface lies from the literal one before its decimation."""
    rows, reports, distances, packed, same = [], [], [], [], 0
    for pixels in images:
        spec = SolidSpec()
        mask = binarise(pixels, spec)
        fast, literal = solidify(pixels, spec), literal_solid(mask, spec, decimated=False)
        report, oracle = PrintReport.of(fast), PrintReport.of(literal)
        counts = count_bodies_and_holes(mask)
        same += counts == (report.bodies, report.genus) == (oracle.bodies, oracle.genus)
        distances_mm = symmetric_distances_mm(fast, literal, points)
        distances.append(distances_mm)
        volume_ratio = fast.volume_m3 / literal.volume_m3
        rows.append((distances_mm.mean(), np.percentile(distances_mm, 99.9), volume_ratio - 1))
        reports.append(report)
        packed.append(fast)
    print_accuracy(np.array(rows), np.concatenate(distances), same, len(images))
    print_sizes(reports, packed)


def print_accuracy(rows: np.ndarray, distances: np.ndarray, same: int, count: int) -> None:
    """Print the distances in mm over all digits, and of the worst digit."""
    means, tails, volumes = rows[:, 0], rows[:, 1], 100 * rows[:, 2]
    within = int(((means <= 0.05) & (tails <= 0.4)).sum())
    print("fast against literal             all digits   worst digit   bound")
    print(f"mean distance, mm              {distances.mean():12.3f} {means.max():13.3f}    0.05")
    print(f"99.9th percentile, mm          {np.percentile(distances, 99.9):12.3f} {tails.max():13.3f}    0.4")
    print(f"digits within both bounds      {within:12d} of {count}")
    print(f"volume, %                      {volumes.mean():+12.2f} {np.abs(volumes).max():13.2f}    1.5")
    print(f"same bodies and holes          {same:12d} of {count}\n")


def print_sizes(reports: list[PrintReport], meshes: list[Mesh]) -> None:
    """Print how the measures of the solids spread over the digits."""
    columns = {
        "vertices": [r.vertices for r in reports],
        "height, mm": [r.size_mm[2] for r in reports],
        "thinnest wall, mm": [r.thinnest_wall_mm for r in reports],
        "overhang, mm^2": [r.overhang_mm2 for r in reports],
        "overhang per footprint": [r.overhang_mm2 * r.size_mm[2] / r.volume_mm3 for r in reports],
        "contact, mm^2": [r.contact_mm2 for r in reports],
        "volume, mm³": [r.volume_mm3 for r in reports],
    }
    print("over the digits                   min       5%      50%      95%      max")
    for name, values in columns.items():
        print(f"{name:28s}" + " ".join(f"{v:8.2f}" for v in np.percentile(values, [0, 5, 50, 95, 100])))
    print(f"\nParquet: {parquet_bytes(meshes) / len(meshes) / 1000:.1f} kB per mesh")
    print(f"warnings: {sum(len(r.warnings) for r in reports)}, solids: {sum(r.is_solid for r in reports)}")
    print(f"largest side: {max(max(r.size_mm) for r in reports) / MM_PER_M:.3f} m")


def parquet_bytes(meshes: list[Mesh]) -> int:
    """Pack the numbers of the meshes as a data set does, and count the bytes."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    def column(arrays: list[np.ndarray], kind: pa.DataType) -> pa.Array:
        starts = np.concatenate([[0], np.cumsum([len(a) for a in arrays])]).astype(np.int32)
        numbers = pa.array(np.concatenate(arrays).ravel(), kind)
        return pa.ListArray.from_arrays(starts, pa.FixedSizeListArray.from_arrays(numbers, 3))

    vertices = column([m.vertices_m for m in meshes], pa.float32())
    faces = column([m.faces for m in meshes], pa.int32())
    names = ("vertices", "faces")
    encodings = ("BYTE_STREAM_SPLIT", "DELTA_BINARY_PACKED")
    packing = {f"{n}.list.element.list.element": code for n, code in zip(names, encodings, strict=True)}
    buffer = io.BytesIO()
    table = pa.table(dict(zip(names, (vertices, faces), strict=True)))
    pq.write_table(
        table, buffer, compression="zstd", compression_level=9, use_dictionary=False, column_encoding=packing
    )
    return len(buffer.getvalue())


if __name__ == "__main__":
    main()
