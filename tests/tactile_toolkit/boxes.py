"""A new kind of data set, in one file: boxes of random sizes."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial

import numpy as np
import pyarrow as pa

from tactile_toolkit.cards import Card
from tactile_toolkit.checked_fields import check_fields, integer, real
from tactile_toolkit.gallery import Gallery
from tactile_toolkit.generation import DefaultSet, RowGenerator, StorageLayout
from tactile_toolkit.kind import DatasetKind, lazy
from tactile_toolkit.mesh import MeshRow, SolidDataset
from tactile_toolkit.pictures import DrawnSolid
from tactile_toolkit.places import loader
from tactile_toolkit.rows import column
from tactile_toolkit.store import ParquetStyle, Skipped

KIND = DatasetKind(
    name="boxes",
    package="tests.tactile_toolkit.boxes",
    noun="box",
    nouns="boxes",
    made_by="boxes generate",
    card_template="mesh_tables.md",
    write_card=lazy("tests.tactile_toolkit.boxes:write_card"),
    schema=lazy("tests.tactile_toolkit.boxes:schema"),
    class_names=("box",),
    plan_gallery=lazy("tests.tactile_toolkit.boxes:plan_gallery"),
    default_set=lazy("tests.tactile_toolkit.boxes:default_set"),
)


class BoxRow(MeshRow):
    id: int = column(pa.int64(), "", "number of the box")
    width_m: float = column(pa.float64(), "m", "extent along x", role="measure", title="Width", decimals=3)


def schema(_manifest=None):
    return BoxRow.schema(("box",))


@dataclass(frozen=True)
class BoxSpec:
    boxes: int = integer(9, 1)
    seed: int = integer(0)
    largest_mm: float = real(20.0, above=10)

    def __post_init__(self):
        check_fields(self, "the boxes")

    def to_dict(self):
        return asdict(self)


@dataclass(frozen=True)
class BoxGenerator(RowGenerator):
    spec: BoxSpec
    kind = KIND

    def items(self):
        return {"train": range(self.spec.boxes)}

    def layout(self):
        return StorageLayout(ParquetStyle(100), ("numpy", "trimesh"), smallest=2, largest=4, usual_shards=8)

    def schema(self, split):
        return schema()

    def make(self, split, items):
        import trimesh

        for number in items:
            rng = np.random.default_rng((self.spec.seed, number))
            size_m = rng.uniform(0.01, self.spec.largest_mm / 1e3, 3)
            box = trimesh.creation.box(size_m)
            if size_m[2] < 0.0105:
                yield Skipped(number, "flat", f"box {number} is {size_m[2]} m high")
            else:
                yield BoxRow(number, 0, box.vertices.astype("f4"), box.faces.astype("i4"), size_m[0])


def default_set(seed, boxes):
    return DefaultSet(BoxGenerator(BoxSpec(boxes or 9, seed)), {"boxes": boxes, "seed": seed})


def write_card(folder, manifest):
    Card(
        template="mesh_tables.md",
        title="Boxes",
        columns=BoxRow.meanings(),
        picture=("boxes.png", "The first boxes from above"),
        licence="cc0-1.0",
        tags=["3d"],
        values={"licence_text": "Anybody may use them.", "citation_text": "Nobody need be cited."},
    ).write(folder, manifest, KIND)


class BoxRecord(DrawnSolid):
    __slots__ = ()

    def caption(self, label_names=()):
        return f"{1e3 * self.row.value('width_m'):.1f} mm wide"


class BoxDataset(SolidDataset):
    record_class = BoxRecord


load = loader(KIND, BoxDataset, BoxRecord)
plan_gallery = partial(Gallery.of_solids, KIND, title="Boxes", columns=BoxRow.with_role("measure"))
