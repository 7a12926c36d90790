"""Solids as torch tensors: a map-style data set for ``DataLoader`` (extra ``torch``)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, get_args

import numpy as np

from tactile_toolkit.errors import InputError, needs_extra
from tactile_toolkit.mesh.records import SolidRecord
from tactile_toolkit.mesh.samples import Box, heights_in, surface_points, voxels_in
from tactile_toolkit.read.dataset import RecordDataset
from tactile_toolkit.wording import is_whole, plain_number

if TYPE_CHECKING:
    import torch
else:
    with needs_extra("a torch data set of solids", "torch", "torch"):
        import torch


Form = Literal["points", "voxels", "height_map", "mesh"]
FORMS: tuple[Form, ...] = get_args(Form)
"""What an item may be, see :class:`SolidTensors`."""

Target = str | Callable[[Any], Any] | None

TARGETS: dict[str, Callable[[Any], Any]] = {
    "label": lambda record: record.label,
    "id": lambda record: record.id,
    "volume_m3": lambda record: torch.tensor(record.volume_m3, dtype=torch.float32),
}
"""What may stand next to a solid: its class, its id, or its volume in cubic metres, float32."""


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

    Item i is ``(tensor, target)``, or without a target the tensor alone. By ``form`` that is

    - ``"points"``: points on the surface, shape (``points``, 3), float32, metres, drawn evenly over its area:
      the same for the same seed, epoch and i, in every process;
    - ``"voxels"``: which voxel centres lie inside, shape (1, layers, rows, columns), uint8, 0 or 1: z upwards
      from 0, then y, then x, both centred on the origin;
    - ``"height_map"``: the top surface, shape (1, rows, columns), float32, metres, 0 next to the solid; row 0
      has the least y;
    - ``"mesh"``: a :class:`MeshItem`; batch with ``collate_fn=collate_meshes``.

    Parameters
    ----------
    dataset : RecordDataset of SolidRecord
        What to give.
    form : str
        One of :data:`FORMS`.
    points : int
        How many points.
    pitch_m : float
        Side of a voxel or pixel, metres.
    extent_m : tuple of three floats, optional
        Size of the grid along x, y and z, metres: that of the kind by default. What lies outside is cut off.
    transform : callable, optional
        Applied to each tensor or :class:`MeshItem`.
    target : str, callable or None
        One of :data:`TARGETS`, or a function of a record.
    seed : int
        Seed of the points.

    Raises
    ------
    InputError
        There is no such form or target, or a number is impossible.
    """

    extent_m: ClassVar[tuple[float, float, float]] = (0.12, 0.12, 0.01)

    def __init__(
        self,
        dataset: RecordDataset[Any],
        form: Form = "points",
        *,
        points: int = 1024,
        pitch_m: float = 0.001,
        extent_m: tuple[float, float, float] | None = None,
        transform: Callable[[Any], Any] | None = None,
        target: Target = "label",
        seed: int = 0,
    ) -> None:
        if form not in FORMS:
            raise InputError(f"no form {form!r}; expected one of {', '.join(FORMS)}")
        if isinstance(target, str) and target not in TARGETS:
            raise InputError(
                f"no target {target!r}; expected one of {', '.join(TARGETS)}, a function of a record, or None"
            )
        counts = plain_number(points), plain_number(seed)
        if not (is_whole(*counts) and counts[0] >= 1 and counts[1] >= 0):
            raise InputError(
                f"points is {points!r} and seed is {seed!r}; expected integers from 1 and from 0"
            )
        from tactile_toolkit.read.torch import shared_zeros  # here: without torch its message is another

        self.dataset = dataset
        self.form = form
        self.points, self.seed = counts
        self.box = Box(extent_m or type(self).extent_m, pitch_m)
        self.transform = transform
        self.target = target
        # Workers that live on from epoch to epoch (persistent_workers) see what is set here.
        self._epoch = shared_zeros()

    @property
    def epoch(self) -> int:
        """The epoch whose points are given."""
        return int(self._epoch)

    def set_epoch(self, epoch: int) -> None:
        """Choose the points of an epoch, from the next item on and in every worker."""
        self._epoch.fill_(epoch)

    @property
    def sequence(self) -> RecordDataset[Any]:
        """The solids, in the order of the items."""
        return self.dataset

    def __len__(self) -> int:
        return len(self.dataset)

    def __getitem__(self, index: int) -> Any:
        """Return one item."""
        place = range(len(self.dataset))[index]
        record = self.dataset[place]
        given = self._tensor(record, place)
        if self.transform is not None:
            given = self.transform(given)
        if self.target is None:
            return given
        # Names are looked up here and not kept as functions: a function without a name does not pickle.
        return given, (TARGETS[self.target] if isinstance(self.target, str) else self.target)(record)

    def _tensor(self, record: SolidRecord, place: int) -> torch.Tensor | MeshItem:
        vertices_m, faces = record.vertices_m, record.faces
        if self.form == "points":
            # Not of torch's generator, whose state differs from worker to worker.
            random = np.random.default_rng([self.seed, self.epoch, place])
            return torch.from_numpy(surface_points(vertices_m, faces, self.points, random))
        if self.form == "voxels":
            return torch.from_numpy(voxels_in(self.box, vertices_m, faces)[None])
        if self.form == "height_map":
            return torch.from_numpy(heights_in(self.box, vertices_m, faces)[None])
        # Copies: torch takes no read-only view.
        return MeshItem(torch.from_numpy(vertices_m.copy()), torch.from_numpy(faces.astype(np.int64)))


def collate_meshes(items: Sequence[Any]) -> Any:
    """Make a batch of meshes of any sizes: a :class:`MeshBatch`, and the targets where items have any.

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
