"""Stored meshes: their columns, typed records, and data sets and streams of them.

The published data sets store a mesh as two flat columns whose names begin with ``mesh.``. Their readers pass
each such column to the mesh class, so no other column may have this prefix (package tactile-mnist 0.13.0).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

import numpy as np
import pyarrow as pa

from tactile_toolkit import read, rows
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.files import pack_mesh, write_mesh
from tactile_toolkit.mesh.mesh import Mesh
from tactile_toolkit.read import schemas
from tactile_toolkit.value_types import AnyArray, Float32, Float64, Int32, JsonValue

if TYPE_CHECKING:
    import trimesh

VERTICES = "mesh.vertices"
"""Column of corner positions: ``list<float32[3]>``, metres."""

FACES = "mesh.faces"
"""Column of triangles: ``list<int32[3]>``, rows of the vertices."""

MESH_COLUMNS = ("id", "label", VERTICES, FACES)
"""Columns of the published mesh layout."""

# Ids and labels are checked row by row: a float may hold an integer.
_MESH_TYPES: dict[str, read.Expected] = {
    VERTICES: read.Expected(2, (pa.types.is_floating,), "three floats per vertex"),
    FACES: read.Expected(2, (pa.types.is_integer,), "three integers per triangle"),
}
R = TypeVar("R", bound=read.Record)
S = TypeVar("S", bound="SolidRecord")
N = TypeVar("N", tuple[str, ...], None)

MESH = "mesh"
"""Column of GLB files, in metres; `datasets` reads it as its feature ``Mesh``."""

SIZES = ("size_x_m", "size_y_m", "size_z_m")


def require_mesh_columns(schema: pa.Schema, name: str, made_by: str) -> None:
    """Raise InputError if the data set ``name`` lacks a column of the published mesh layout.

    ``made_by`` is the command that writes such data sets, for the message.
    """
    names = read.column_names(schema)
    missing = [column for column in MESH_COLUMNS if column not in names]
    problem = f"column {missing[0]!r} is missing (found {', '.join(names)})" if missing else ""
    problem = problem or read.Expected.problem(read.column_types(schema), _MESH_TYPES)
    if problem:
        raise InputError(
            f"{name!r} is not a data set of meshes: {problem}",
            next=f"name a data set such as one written by `{made_by}`",
        )


class MeshRow(rows.TypedRow):
    """A row with a mesh; row classes of each kind add their own columns after these."""

    id: int = rows.column(pa.int64())
    label: int = rows.column(pa.int64())
    vertices_m: AnyArray = rows.column(
        read.vectors_type(pa.float32()), "V x 3, m, frame below", "corner positions", name=VERTICES
    )
    faces: AnyArray = rows.column(
        read.vectors_type(pa.int32()),
        "F x 3",
        "triangles: rows of the corners, counter-clockwise seen from outside",
        name=FACES,
    )

    @staticmethod
    def encodings(of_vertices: str) -> tuple[tuple[str, str], ...]:
        """Return the encodings of the columns of a mesh in Parquet, of vertices and of faces."""
        named = ((VERTICES, of_vertices), (FACES, "DELTA_BINARY_PACKED"))
        return tuple((f"{name}.list.element.list.element", encoding) for name, encoding in named)

    @classmethod
    def schema(cls, class_names: tuple[str, ...], without: tuple[str, ...] = ()) -> pa.Schema:
        """Return the Arrow schema, except some columns; its metadata suit `datasets`."""
        schema = pa.schema([field for field in cls.plain_schema() if field.name not in without])
        features = {field.name: _feature(field.type) for field in schema}
        features["label"] = schemas.label_feature(class_names)
        return schema.with_metadata(schemas.feature_metadata(features))


def _feature(data_type: pa.DataType) -> JsonValue:
    """Describe a column to `datasets`, in a form that both old and new releases read."""
    if pa.types.is_list(data_type) and pa.types.is_struct(data_type.value_type):
        return [{field.name: _feature(field.type) for field in data_type.value_type}]
    if pa.types.is_fixed_size_list(data_type):
        inner = _feature(data_type.value_type)
        return {"feature": inner, "length": data_type.list_size, "_type": "Sequence"}
    if pa.types.is_list(data_type):
        return {"feature": _feature(data_type.value_type), "_type": "Sequence"}
    return {"dtype": read.dtype_name(data_type), "_type": "Value"}


class SolidRecord(read.Record):
    """One row of the published mesh layout: an id, a label and a mesh. Fields are loaded on first use."""

    __slots__ = ()

    @property
    def id(self) -> int:
        """Number of the row, unique in its data set."""
        return self.row.integer("id")

    @property
    def label(self) -> int:
        """Number of the class."""
        return self.row.integer("label")

    @property
    def vertices_m(self) -> Float32:
        """Vertices, shape (V, 3), float32, metres; a read-only view of the stored values."""
        return self.row.array(VERTICES)

    @property
    def faces(self) -> Int32:
        """Triangles, shape (F, 3), int32, counter-clockwise seen from outside; a read-only view."""
        return self.row.array(FACES)

    @property
    def mesh(self) -> trimesh.Trimesh:
        """The mesh, in metres; no vertex is merged, dropped or moved."""
        # Nearly all of the 76 µs are spent in trimesh, which converts float32 (benchmarks/README.md).
        mesh: trimesh.Trimesh = self._once("mesh", lambda: Mesh(self.vertices_m, self.faces).to_trimesh())
        return mesh

    @property
    def volume_m3(self) -> float:
        """Volume in cubic metres: the stored value, or else that of the mesh."""
        return float(self.row.required("volume_m3") if self.row.has("volume_m3") else self.mesh.volume)

    def export(self, path: str | Path) -> None:
        """Write the mesh to a file, in the unit of the format.

        Parameters
        ----------
        path : str or Path
            Ends with .stl, .3mf, .ply or .obj, which are in millimetres, or .glb, in metres.

        Raises
        ------
        InputError, StorageError
            The ending is unknown; the file cannot be written.
        """
        write_mesh(path, self)

    def __repr__(self) -> str:
        return f"{type(self).__name__}(id={self.id}, label={self.label}, {len(self.faces):,} faces)"


class SolidDataset(read.RecordDataset[S]):
    """A lazy sequence of meshes in the published layout."""

    record_class: ClassVar[Any] = SolidRecord
    things = "solids"
    extent_m: ClassVar[tuple[float, float, float]] = (0.12, 0.12, 0.01)
    """Size along x, y and z of the grids of :class:`SolidTensors`, metres: the published cell."""

    @staticmethod
    def classes_of(
        shards: tuple[read.Shard, ...], name: str, made_by: str, default: N
    ) -> tuple[str, ...] | N:
        """Return the classes that shards of meshes state, or ``default``.

        Raises InputError if they lack columns of meshes, or differ in their classes. ``name`` is that of the
        data set, and ``made_by`` the command that writes such data sets, for messages.
        """
        classes: dict[tuple[str, ...] | N, None] = {}
        for schema in read.ShardedTable(shards).schemas:
            require_mesh_columns(schema, name, made_by)
            classes[read.class_names(schema, default, name)] = None
        if len(classes) > 1:
            shown = " and ".join(", ".join(names or ("no names",)) for names in list(classes)[:2])
            raise InputError(f"{name!r} has the classes {shown}", next="open files of one data set together")
        return next(iter(classes))

    @property
    def volumes_m3(self) -> Float64:
        """Volume of each row, shape (len,), float64, cubic metres; loads meshes only where none is stored."""
        if self.has_column("volume_m3"):
            return np.asarray(self.column("volume_m3"), np.float64)
        return np.array([record.volume_m3 for record in self], np.float64)


class RecordStream(read.RowStream[read.RowSource], Generic[R]):
    """Records one after another; see :class:`tactile_toolkit.read.RowStream`.

    Parameters
    ----------
    shards : tuple of RowSource
        Shards, read in order.
    record : type
        Class of the records.
    default_names : tuple of str
        Class names for shards without any.
    """

    def __init__(
        self, shards: tuple[read.RowSource, ...], record: type[R], default_names: tuple[str, ...]
    ) -> None:
        super().__init__(shards)
        self._record = record
        self._default_names = default_names

    @property
    def label_names(self) -> tuple[str, ...]:
        """Name of each class."""
        return read.class_names(self.shards[0].schema, self._default_names)

    def __repr__(self) -> str:
        return self._described(self._record.__name__)

    def __iter__(self) -> Iterator[R]:
        """Decode one block of rows at a time."""
        for shard, index in self.row_groups():
            for block in shard.blocks(index):
                yield from (self._record(read.Row(block, row)) for row in range(len(block.table)))


def flat_table(solids: read.RecordDataset[Any]) -> pa.Table:
    """Return an Arrow table: all stored columns but the mesh, then class name, size and GLB file."""
    stored = solids.to_hf()
    kept = [name for name in stored.column_names if name not in (VERTICES, FACES)]
    table = stored.select_columns(kept).with_format("arrow")[:]
    features = stored.features.to_dict()
    classes = dict(enumerate(solids.label_names))
    names = [classes.get(label, str(label)) for label in solids.labels.tolist()]
    table = table.add_column(kept.index("label") + 1, "label_name", pa.array(names, pa.string()))
    sizes, files = [], []
    for number, record in enumerate(solids):
        mesh = Mesh(record.vertices_m, record.faces)
        sizes.append(np.ptp(np.asarray(mesh.vertices_m, np.float64), axis=0))
        # `datasets` infers the file format from the name.
        files.append({"bytes": pack_mesh(mesh, ".glb"), "path": f"{number:05d}.glb"})
    for name, values in zip(SIZES, np.reshape(sizes, (-1, 3)).T, strict=True):
        table = table.append_column(name, pa.array(values, pa.float64()))
    table = table.append_column(
        MESH, pa.array(files, pa.struct([("bytes", pa.binary()), ("path", pa.string())]))
    )
    described = {
        name: features.get(name, {"dtype": "float64", "_type": "Value"}) for name in table.column_names
    }
    described |= {"label_name": {"dtype": "string", "_type": "Value"}, MESH: {"_type": "Mesh"}}
    return table.replace_schema_metadata(schemas.feature_metadata(described))
