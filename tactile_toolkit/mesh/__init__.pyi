"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .solid_check import (
    BASE_MARGIN_MM as BASE_MARGIN_MM,
    check_manifold as check_manifold,
    with_flat_underside as with_flat_underside,
)
from .files import (
    MeshFile as MeshFile,
    read_mesh as read_mesh,
    write_mesh as write_mesh,
)
from .mesh import (
    Mesh as Mesh,
    MeshLike as MeshLike,
    MM_PER_M as MM_PER_M,
)
from .box_tree import (
    connected as connected,
)
from .printability import (
    PrintReport as PrintReport,
)
from .mesh_options import (
    PrintProfile as PrintProfile,
    refuse_unit as refuse_unit,
    UNIT as UNIT,
)
from .raster import (
    highest_values as highest_values,
)
from .records import (
    FACES as FACES,
    MESH_COLUMNS as MESH_COLUMNS,
    MeshRow as MeshRow,
    RecordStream as RecordStream,
    require_mesh_columns as require_mesh_columns,
    SolidDataset as SolidDataset,
    SolidRecord as SolidRecord,
    VERTICES as VERTICES,
)
from .solid_tensors import (
    MeshBatch as MeshBatch,
    MeshItem as MeshItem,
    SolidTensors as SolidTensors,
    collate_meshes as collate_meshes,
)
