"""What an expert would write with libraries of the field, for the benchmarks to compare with.

`plain_digit.py` has that for digits. Each gives the same output as the toolkit, without its checks.
"""

from __future__ import annotations

import io
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

IN_MEMORY = "a column of pyarrow in memory"
"""The name of the way that :func:`stored_media` reads."""

_RADIUS_M, _HEIGHT_M = 0.01, 0.005  # of the objects of a scene
_PER_M = 1e3  # Embree computes in float32, with tolerances for sizes of about 1


def medians_in_turn_s(
    works: Sequence[Callable[[], Any]], turns: int, clock: Callable[[], float] = time.perf_counter
) -> list[float]:
    """Return the median time of each; they take turns, so that other work weighs on all alike.

    A first turn is not counted.
    """
    times = np.empty((turns + 1, len(works)))
    for row in times:
        for number, work in enumerate(works):
            start_s = clock()
            work()
            row[number] = clock() - start_s
    return [statistics.median(column) for column in times[1:].T.tolist()]


def stored_media(folder: Path, column: str) -> pa.Array:
    """Return the encoded images or clips of a data set, one after the other, in memory."""
    tables = [pq.read_table(file, columns=[column]) for file in sorted((folder / "data").glob("*.parquet"))]
    rounds = pa.concat_tables(tables).column(0).combine_chunks()
    return pc.cast(rounds.flatten().field("bytes"), pa.large_binary())


def pixels(column: pa.Array, index: int) -> np.ndarray:
    """Decode an image of a column by Pillow."""
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(column[index].as_buffer())))


class Rays:
    """Heights of a solid under points, by rays of Embree that fall straight down."""

    name = "rays of Embree, `embreex`"

    def __init__(self, vertices_m: np.ndarray, faces: np.ndarray) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self._scene = EmbreeScene(robust=True)
        self._mesh = TriangleMesh(self._scene, (_PER_M * np.asarray(vertices_m)).astype(np.float32)[faces])
        self._start_m = float(vertices_m[:, 2].max()) + 0.01

    def heights_m(self, x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
        """Return the height at each point; NaN where there is nothing."""
        origins = _PER_M * np.stack([x_m, y_m, np.full_like(x_m, self._start_m)], 1).astype(np.float32)
        down = np.tile(np.array([0, 0, -1], np.float32), (len(origins), 1))
        distance = self._scene.run(origins, down, query="DISTANCE")
        return np.where(distance < 1e10, self._start_m - distance / _PER_M, np.nan)

    def depth_m(self, object_pose: np.ndarray, sensor_pose: np.ndarray, sensor: Any) -> np.ndarray:
        """Return the depth map of a touch, (H, W), metres, of an upright sensor that was pressed on."""
        width, height = sensor.size_px
        x_m, y_m = (
            (np.arange(count) - (count - 1) / 2) * extent / count
            for count, extent in zip((width, height), sensor.window_m, strict=True)
        )
        offset_m = np.multiply(sensor.sample_px, sensor.pixel_m)
        points = np.stack(np.meshgrid(x_m, -y_m), -1).reshape(-1, 2) + offset_m + sensor_pose[:2, 3]
        # The solid stays where the scene of Embree has it: the points turn instead.
        points = (points - object_pose[:2, 3]) @ object_pose[:2, :2]
        heights = np.nan_to_num(self.heights_m(points[:, 0], points[:, 1]), nan=0.0).reshape(height, width)
        return np.minimum(heights.max() - heights + sensor.press_m, sensor.gel_m)


def scenes(count: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield vertices and faces of scenes: the published sampling with NumPy, templates of trimesh."""
    import trimesh
    from tactile_mnist.starstruck_dataset import VALID_CELL_SIZE, make_star_mesh

    side_m = np.sqrt(2) * _RADIUS_M
    shapes = [
        make_star_mesh(),
        trimesh.creation.box(extents=(side_m, side_m, _HEIGHT_M)),
        trimesh.creation.cylinder(_RADIUS_M, _HEIGHT_M, sections=32),
    ]
    corners = [np.asarray(shape.vertices) - [0, 0, shape.vertices[:, 2].min()] for shape in shapes]
    faces = [np.asarray(shape.faces) for shape in shapes]
    for number in range(count):
        random = np.random.default_rng(number)
        kinds = [0] * (1 + number % 3) + (1 + random.integers(2, size=number // 3 % 6)).tolist()
        centres = np.empty((0, 2))
        while len(centres) < len(kinds):
            centre = random.uniform(-0.5, 0.5, 2) * VALID_CELL_SIZE
            if (np.hypot(*(centres - centre).T) > 2 * _RADIUS_M).all():
                centres = np.vstack([centres, centre])
        angles = random.uniform(0, 2 * np.pi, len(kinds))
        vertices, triangles, first = [], [], 0
        for kind, centre, cosine, sine in zip(kinds, centres, np.cos(angles), np.sin(angles), strict=True):
            x, y, z = corners[kind].T
            vertices.append(
                np.stack([cosine * x - sine * y + centre[0], sine * x + cosine * y + centre[1], z], 1)
            )
            triangles.append(faces[kind] + first)
            first += len(x)
        yield np.concatenate(vertices), np.concatenate(triangles)


def touch_rows(batch: pa.RecordBatch) -> pa.Table:
    """Return a row for each touch of some rounds: its image as it is stored, label, position and pose."""
    images = batch["sensor_image"]
    rounds = pc.list_parent_indices(images)
    columns: dict[str, Any] = {"image": images.flatten()}
    columns |= {name: batch[name].take(rounds) for name in ("id", "label", "object_id")}
    for name, axes in (("pos_in_cell", "xy"), ("position", "xyz"), ("quaternion", "xyzw")):
        stored = batch[name if name == "pos_in_cell" else f"gel_pose_cell_frame.{name}"]
        vectors = stored.flatten().flatten().to_numpy().reshape(-1, len(axes))
        columns |= {f"{name}_{axis}": vectors[:, number] for number, axis in enumerate(axes)}
    lengths = pc.list_value_length(images).to_numpy()
    columns["touch"] = np.concatenate([np.arange(length) for length in lengths])
    return pa.table(columns)
