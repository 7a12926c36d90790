"""What a gallery shows: items, what they can be filtered by, and the work that makes them.

Meshes and thumbnails are made small. A mesh is packed in integer steps of 10 µm, differences, deflated, as
text: a digit of 5,000 vertices takes about 30 kB so, where its plain arrays take 180 kB.
"""

from __future__ import annotations

import base64
import io
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tactile_toolkit import catalog, mesh, pictures, places, read
from tactile_toolkit.array_types import Floating, Int64, Integers, UInt8
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.kind import DatasetKind

NONE = "none"
"""Facet value of items without a value, so that these can be looked at too."""

SPLIT = "split"
"""Name of the facet of splits; its values stand in the order of the data set."""

STEP_MM = 0.01
"""Grid that corners are rounded to, a twentieth of a printed layer; coarser for meshes above 655 mm and finer
for those below 10 mm."""

THUMBNAIL_PX = 144
"""Longer side of a thumbnail."""

_MARGIN_PX = 9  # of `relief`, on both sides together
_FEWEST_STEPS = 1_000
_LEAST_STEP_MM = 1e-6
_MOST_STEPS = np.iinfo(np.uint16).max


@dataclass(frozen=True, slots=True)
class Facet:
    """Something that items are filtered by; ``name`` is its key in :attr:`Item.facets`.

    ``values`` are shown in their order, others that items have follow in natural order.
    """

    name: str
    title: str
    values: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Measure:
    """A number of each item, shown with it and sorted by; ``name`` is its key in :attr:`Item.measures`."""

    name: str
    title: str
    unit: str = ""  # as it is shown; empty for counts
    decimals: int = 0


@dataclass(frozen=True, slots=True)
class Item:
    """One item as a worker hands it over."""

    id: str  # what it is searched by
    title: str
    facets: Mapping[str, Sequence[str]]
    measures: Mapping[str, float | None]  # None, or no entry, where it is unknown
    thumbnail: bytes = field(repr=False)  # PNG
    # JSON values that the page loads when the item is opened: "notes" (pairs of a title and a text) and
    # either "mesh" (see packed_mesh) or "touches".
    content: Mapping[str, Any] = field(repr=False)
    # Further files by the end of their name, such as "000.jpg".
    media: Mapping[str, bytes] = field(default_factory=dict, repr=False)


@dataclass(frozen=True)
class RowsTask:
    """Makes the items of some rows of a split, from each row and what was known of it beforehand.

    Pickles with what is known of these rows alone; ``item`` takes record, split, class names and the known.
    """

    dataset: read.RecordDataset[Any]
    split: str
    item: Callable[[Any, str, tuple[str, ...], Any], Item]
    known: tuple[Any, ...] = field(repr=False)

    @property
    def size(self) -> int:
        """How many items it makes."""
        return len(self.dataset)

    def make(self) -> list[Item]:
        """Make the items, in order."""
        names = self.dataset.label_names
        return [
            self.item(record, self.split, names, known)
            for record, known in zip(self.dataset, self.known, strict=True)
        ]


@dataclass(frozen=True)
class Gallery:
    """What a site is to hold, and the tasks that make its items, in the order of the page."""

    kind: str  # of the data set, such as "mnist3d"
    title: str
    nouns: tuple[str, str]  # one item and several
    facets: tuple[Facet, ...]
    measures: tuple[Measure, ...]
    tasks: tuple[RowsTask, ...]
    splits: Mapping[str, int]  # how many items of each are shown

    @property
    def size(self) -> int:
        """How many items there are."""
        return sum(task.size for task in self.tasks)


def gallery_of_rows(
    kind: DatasetKind,
    name: places.Name | places.Place,
    chosen: catalog.Chosen,
    title: str,
    facets: tuple[Facet, ...],
    measures: tuple[Measure, ...],
    item: Callable[[Any, str, tuple[str, ...], Any], Item],
    rows_per_task: int,
    known: Callable[[Any, str], Sequence[Any]] = lambda rows, _: [None] * len(rows),
) -> Gallery:
    """Plan a gallery of the rows that are chosen of some splits; see :class:`RowsTask` for ``item``.

    ``known`` takes the chosen rows and their split, and says what is known of each beforehand.

    InputError: no such data set or split, or one of another kind. IntegrityError: it is damaged or
    unfinished. HubError: the repository cannot be reached or does not exist.
    """
    among = chosen.given()
    only = among.pop("split")
    place = places.open_place(name).require(kind, "gallery")
    opened = catalog.open_splits(place, only, kind.load, kind.nouns)
    tasks: list[RowsTask] = []
    shown: dict[str, int] = {}
    for split, dataset, positions in catalog.choose_rows(opened.items(), **among):
        rows = dataset[positions]
        shown[split] = len(rows)
        given = known(rows, split)
        for start in range(0, len(rows), rows_per_task):
            part = slice(start, start + rows_per_task)
            tasks.append(RowsTask(rows[part], split, item, tuple(given[part])))
    heading = f"{title} · {catalog.short_name(place.name)}"
    if place.unfinished:
        heading = f"{heading} (unfinished, {place.unfinished})"
    return Gallery(kind.name, heading, (kind.noun, kind.nouns), facets, measures, tuple(tasks), shown)


def packed_mesh(
    vertices_m: Floating,
    faces: Integers,
    parts: Sequence[tuple[int, str]] = (),
    *,
    flat: bool = False,
) -> dict[str, Any]:
    """Pack a mesh, (V, 3) in metres with z up and (F, 3), as JSON values for the viewer of the page.

    ``parts`` are runs of triangles and the paint of each, ``"main"`` or ``"other"``; all are ``"main"`` by
    default. ``flat`` shows edges sharp instead of rounding the shade off. ``vertices`` and ``faces`` become
    base64 of zlib of four planes of bytes (lowest first) of zigzag numbers, each the difference to the number
    before; vertices as x of all, y of all, z of all in steps of ``step_mm`` above ``low_mm``.
    """
    vertices_mm = np.asarray(vertices_m, np.float64) * mesh.MM_PER_M
    low_mm = vertices_mm.min(axis=0)
    extent_mm = float((vertices_mm.max(axis=0) - low_mm).max())
    step_mm = max(min(STEP_MM, max(extent_mm / _FEWEST_STEPS, _LEAST_STEP_MM)), extent_mm / _MOST_STEPS)
    steps = np.round((vertices_mm - low_mm) / step_mm).astype(np.int64)
    return {
        "vertices": _packed(steps.T.reshape(-1)),
        "faces": _packed(np.asarray(faces, np.int64).reshape(-1)),
        "vertex_count": len(vertices_mm),
        "face_count": len(faces),
        "step_mm": step_mm,
        "low_mm": [round(float(value), 6) for value in low_mm],
        "parts": [list(part) for part in parts] or [[len(faces), "main"]],
        "flat": flat,
    }


def _packed(numbers: Int64) -> str:
    # Neighbours differ little, so the upper planes of bytes are almost all zero and deflate to nothing.
    change = np.diff(numbers, prepend=0)
    # Small differences of either sign become small numbers (as in Protocol Buffers).
    zigzag = ((change << 1) ^ (change >> 63)).astype("<u4")
    planes = zigzag.view(np.uint8).reshape(-1, 4).T
    return base64.b64encode(zlib.compress(planes.tobytes(), 6)).decode("ascii")


def size_text(vertices_m: Floating) -> str:
    """Write the size of a mesh for people: ``"38.2 x 52.1 x 8.0 mm"``."""
    size_mm = np.ptp(np.asarray(vertices_m, np.float64), axis=0) * mesh.MM_PER_M
    return " x ".join(f"{side:.1f}" for side in size_mm) + " mm"


def require_mesh(record: mesh.SolidRecord, split: str) -> None:
    """Refuse a stored mesh that nothing can draw, with an IntegrityError."""
    problem = mesh.array_problem(mesh.Mesh(record.vertices_m, record.faces))
    if problem is not None:
        raise IntegrityError(
            f"the mesh of id {record.id} in split {split!r} cannot be drawn: {problem[1]}",
            next="run `verify` and `validate` on the data set, then generate or download it again",
        )


def thumbnail(pixels: UInt8, opaque_from: int | None = None) -> bytes:
    """Make the thumbnail, a PNG, of grey levels, (H, W), or colours, (H, W, 3).

    With ``opaque_from``, paper, which has the colour of the top left pixel, becomes transparent, so that it
    looks right on light and dark pages: what is so many levels darker is opaque, what is less dark shows the
    page through. 1 is for pictures without smoothed edges.
    """
    from PIL import Image

    picture = Image.fromarray(np.ascontiguousarray(pixels))
    if opaque_from is not None:
        layers = pixels.reshape(*pixels.shape[:2], -1).astype(np.float32)
        paper = layers[0, 0]
        share = np.clip((paper - layers).max(axis=-1) / opaque_from, 0, 1)[..., None]
        # What the paper adds to a smoothed edge is taken out again, so that no light rim shows on a dark
        # page.
        ink = np.clip((layers - (1 - share) * paper) / np.maximum(share, 1 / 255), 0, 255)
        levels = np.concatenate([np.where(share > 0, ink, 0), 255 * share], axis=-1).round().astype(np.uint8)
        picture = Image.fromarray(levels, "LA" if levels.shape[-1] == 2 else "RGBA")
    picture.thumbnail((THUMBNAIL_PX, THUMBNAIL_PX), Image.Resampling.BOX)
    stream = io.BytesIO()
    picture.save(stream, "PNG", compress_level=6)
    return stream.getvalue()


def relief_thumbnail(vertices_m: Floating, faces: Integers) -> bytes:
    """Make the thumbnail of a mesh from above, as large as its tile: 3 cm are recognised like 8."""
    longest_m = float(np.ptp(vertices_m[:, :2], axis=0).max())
    # Drawn twice as large but for the margin of a relief; another source's mesh may have no extent at all.
    pitch_m = max(longest_m, 1e-6) / (2 * THUMBNAIL_PX - _MARGIN_PX)
    return thumbnail(pictures.relief(vertices_m, faces, pitch_m), opaque_from=1)
