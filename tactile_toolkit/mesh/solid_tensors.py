"""Solids as torch tensors: a map-style data set for ``DataLoader`` (extra ``torch``)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, get_args

import numpy as np

from tactile_toolkit import read
from tactile_toolkit.checked_fields import checked_integer
from tactile_toolkit.errors import InputError, needs_extra
from tactile_toolkit.mesh.raster import MAX_PIXELS, covered_pixels, highest_values
from tactile_toolkit.mesh.records import SolidDataset, SolidRecord
from tactile_toolkit.read import training_batches
from tactile_toolkit.value_types import Float32, Float64, Floating, Integers, UInt8

if TYPE_CHECKING:
    import torch
else:
    with needs_extra("a torch data set of solids", "torch", "torch"):
        import torch


# Columns of voxels are sampled this far from their centres, in voxels, where no edge of a solid lies: only
# one of the triangles that share an edge is met.
_ASIDE_PX = (0.618e-5, 0.414e-5)


@dataclass(frozen=True, slots=True)
class VoxelGrid:
    """A grid of voxels, centred on the origin along x and y, from z = 0 upwards.

    Attributes
    ----------
    extent_m : tuple of three floats
        Size along x, y and z, metres.
    pitch_m : float
        Side of a voxel or pixel, metres.

    Raises
    ------
    InputError
        A length is not positive, or the grid is too large.
    """

    extent_m: tuple[float, float, float]
    pitch_m: float

    def __post_init__(self) -> None:
        lengths = np.array([*self.extent_m, self.pitch_m], np.float64)
        possible = lengths.shape == (4,) and bool((lengths > 0).all()) and bool(np.isfinite(lengths).all())
        if not possible or not np.prod(np.maximum(1.0, lengths[:3] / lengths[3])) <= MAX_PIXELS:
            raise InputError(
                f"a grid of {self.extent_m!r} m in steps of {self.pitch_m!r} m was asked for; expected three "
                f"positive lengths and a step such as 0.001, at most {MAX_PIXELS:,} voxels"
            )

    @property
    def shape(self) -> tuple[int, int, int]:
        """Voxels along z, y and x."""
        columns, rows, layers = (max(1, round(length / self.pitch_m)) for length in self.extent_m)
        return layers, rows, columns

    def grid_points(self, vertices_m: Floating) -> Float64:
        """Return column, row and layer of vertices, shape (3, V); voxel centres have integer coordinates."""
        _, rows, columns = self.shape
        middle = np.array([[columns / 2.0], [rows / 2.0], [0.0]])
        return np.asarray(vertices_m.T.astype(np.float64) / self.pitch_m + (middle - 0.5))


def surface_points(
    vertices_m: Floating,
    faces: Integers,
    count: int,
    random: np.random.Generator,
) -> Float32:
    """Draw points uniformly on a surface: shape (count, 3), float32, metres."""
    a, b, c = (vertices_m[corner].astype(np.float64) for corner in np.asarray(faces).T)
    areas = np.cumsum(np.linalg.norm(np.cross(b - a, c - a), axis=1))
    numbers = random.random((3, count))
    face = np.minimum(np.searchsorted(areas, numbers[0] * areas[-1], side="right"), len(areas) - 1)
    # The square root makes the density uniform, because a triangle narrows towards its first corner.
    root = np.sqrt(numbers[1])[:, None]
    along = numbers[2][:, None]
    points = a[face] * (1.0 - root) + b[face] * (root * (1.0 - along)) + c[face] * (root * along)
    return np.asarray(points, np.float32)


def heights_in(grid: VoxelGrid, vertices_m: Floating, faces: Integers) -> Float32:
    """Return the height of the top surface over each pixel centre, 0 next to the solid.

    Shape (rows, columns), float32, metres; row 0 has the least y.
    """
    points = grid.grid_points(vertices_m)
    points[2] = vertices_m[:, 2]
    heights_m = highest_values(points, faces, grid.shape[1:])
    return np.where(np.isneginf(heights_m), np.float32(0), heights_m)


def voxels_in(grid: VoxelGrid, vertices_m: Floating, faces: Integers) -> UInt8:
    """Return the voxels whose centres are inside a solid, shape (layers, rows, columns) of z, y, x, uint8."""
    layers, rows, columns = grid.shape
    points = grid.grid_points(vertices_m)
    points[:2] += np.array(_ASIDE_PX)[:, None]
    (ab_x, ab_y), (ac_x, ac_y) = (points[:2, faces.T[corner]] - points[:2, faces.T[0]] for corner in (1, 2))
    upwards = ab_x * ac_y > ab_y * ac_x
    # Number of entries minus number of exits on the way up a column: 1 inside.
    # One extra layer for entries and exits above the grid.
    change = np.zeros((layers + 1) * rows * columns, np.int32)
    for face, line, pixel, height in covered_pixels(points, faces, (rows, columns), both_sides=True):
        layer = np.clip(np.ceil(height), 0, layers).astype(np.int64)
        np.add.at(change, layer * (rows * columns) + pixel, np.where(upwards[face[line]], -1, 1))
    inside = np.cumsum(change.reshape(layers + 1, rows, columns)[:-1], axis=0) > 0
    return inside.astype(np.uint8)


Representation = Literal["points", "voxels", "height_map", "mesh"]
Target = str | Callable[[Any], object] | None


class MeshItem(NamedTuple):
    """One mesh.

    Attributes
    ----------
    vertices : Tensor, shape (V, 3), float32
        Metres.
    faces : Tensor, shape (F, 3), int64
        Rows of ``vertices``, counter-clockwise seen from outside.
    """

    vertices: torch.Tensor
    faces: torch.Tensor


class MeshBatch(NamedTuple):
    """Meshes of any sizes, one after another.

    Attributes
    ----------
    vertices : Tensor, shape (sum of V, 3), float32
        Metres.
    faces : Tensor, shape (sum of F, 3), int64
        Rows of ``vertices`` of the batch.
    vertex_counts, face_counts : Tensor, shape (meshes,), int64
        V and F of each mesh: ``vertices.split(vertex_counts.tolist())`` takes them apart.
    """

    vertices: torch.Tensor
    faces: torch.Tensor
    vertex_counts: torch.Tensor
    face_counts: torch.Tensor


class SolidTensors(torch.utils.data.Dataset):  # type: ignore[misc]
    """A map-style data set of solids.

    Item i is ``(tensor, target)``, or only the tensor without a target. The tensor is, by
    ``representation``,

    - ``"points"``: points on the surface, shape (``points``, 3), float32, metres, drawn evenly over its area:
      the same for the same seed, epoch and i, in every process;
    - ``"voxels"``: which voxel centres lie inside, shape (1, layers, rows, columns), uint8, 0 or 1: z upwards
      from 0, then y, then x, both centred on the origin;
    - ``"height_map"``: the top surface, shape (1, rows, columns), float32, metres, 0 next to the solid; row 0
      has the least y;
    - ``"mesh"``: a :class:`MeshItem`; batch with ``collate_fn=collate_meshes``.

    Parameters
    ----------
    dataset : SolidDataset
        The solids, such as digits or scenes.
    representation : str
        One of :attr:`REPRESENTATIONS`.
    points : int
        Number of points.
    pitch_m : float
        Side of a voxel or pixel, metres.
    extent_m : tuple of three floats, optional
        Size of the grid along x, y and z, metres; ``dataset.extent_m`` by default. Parts outside are cut off.
    transform : callable, optional
        Applied to each tensor or :class:`MeshItem`.
    target : str, callable or None
        One of :attr:`TARGETS`, or a function of a record.
    seed : int
        Seed of the points.

    Raises
    ------
    InputError
        The representation or the target is unknown, or a number is impossible.
    """

    REPRESENTATIONS: ClassVar[tuple[Representation, ...]] = get_args(Representation)
    """Representations of items."""
    TARGETS: ClassVar[dict[str, Callable[[SolidRecord], object]]] = {
        "label": lambda record: record.label,
        "id": lambda record: record.id,
        "volume_m3": lambda record: torch.tensor(record.volume_m3, dtype=torch.float32),
    }
    """Targets of items: class, id, or volume in cubic metres, float32."""

    def __init__(
        self,
        dataset: SolidDataset[Any],
        representation: Representation = "points",
        *,
        points: int = 1024,
        pitch_m: float = 0.001,
        extent_m: tuple[float, float, float] | None = None,
        transform: Callable[[Any], Any] | None = None,
        target: Target = "label",
        seed: int = 0,
    ) -> None:
        if representation not in self.REPRESENTATIONS:
            expected = ", ".join(self.REPRESENTATIONS)
            raise InputError(f"no representation {representation!r}; expected one of {expected}")
        if isinstance(target, str) and target not in self.TARGETS:
            known = ", ".join(self.TARGETS)
            raise InputError(
                f"no target {target!r}; expected one of {known}, a function of a record, or None"
            )

        self.dataset = dataset
        self.representation = representation
        self.points = checked_integer(points, "points", 1)
        self.seed = checked_integer(seed, "seed")
        self.grid = VoxelGrid(extent_m or dataset.extent_m, pitch_m)
        self.transform = transform
        self.target = target
        # Shared, so that persistent workers see changes.
        self._epoch = training_batches.shared_zeros()

    @property
    def epoch(self) -> int:
        """The current epoch, which determines the points."""
        return int(self._epoch)

    def set_epoch(self, epoch: int) -> None:
        """Set the epoch, from the next item on and in all workers."""
        self._epoch.fill_(epoch)

    @property
    def sequence(self) -> read.RecordDataset[Any]:
        """The solids, in order of the items."""
        return self.dataset

    def __len__(self) -> int:
        return len(self.dataset)

    def __getitem__(self, index: int) -> Any:
        """Return one item."""
        row_index = range(len(self.dataset))[index]
        record = self.dataset[row_index]
        tensor = self._tensor(record, row_index)
        if self.transform is not None:
            tensor = self.transform(tensor)
        if self.target is None:
            return tensor
        # Looked up here, because functions without names do not pickle.
        return tensor, (self.TARGETS[self.target] if isinstance(self.target, str) else self.target)(record)

    def _tensor(self, record: SolidRecord, row_index: int) -> torch.Tensor | MeshItem:
        vertices_m, faces = record.vertices_m, record.faces
        if self.representation == "points":
            # Not torch's generator, whose state differs between workers.
            random = np.random.default_rng([self.seed, self.epoch, row_index])
            return torch.from_numpy(surface_points(vertices_m, faces, self.points, random))
        if self.representation == "voxels":
            return torch.from_numpy(voxels_in(self.grid, vertices_m, faces)[None])
        if self.representation == "height_map":
            return torch.from_numpy(heights_in(self.grid, vertices_m, faces)[None])
        # Copied, because torch does not accept read-only arrays.
        return MeshItem(torch.from_numpy(vertices_m.copy()), torch.from_numpy(faces.astype(np.int64)))


def collate_meshes(items: Sequence[Any]) -> Any:
    """Collate meshes of any sizes: a :class:`MeshBatch`, and targets if items have any.

    Parameters
    ----------
    items : sequence
        Of :class:`MeshItem`, or of pairs of one and a target.

    Returns
    -------
    MeshBatch or tuple of MeshBatch and targets
        Targets are batched as by ``torch.utils.data.default_collate``.
    """
    if not isinstance(items[0], MeshItem):
        meshes, targets = zip(*items, strict=True)
        return collate_meshes(meshes), torch.utils.data.default_collate(list(targets))
    vertex_counts, face_counts = (
        torch.tensor([len(item[part]) for item in items], dtype=torch.int64) for part in (0, 1)
    )
    first = vertex_counts.cumsum(0) - vertex_counts
    faces = [item.faces + start for item, start in zip(items, first, strict=True)]
    return MeshBatch(
        torch.cat([item.vertices for item in items]), torch.cat(faces), vertex_counts, face_counts
    )
