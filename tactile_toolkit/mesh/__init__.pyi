"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .solid_check import (
    check_manifold as check_manifold,
    ManifoldCheck as ManifoldCheck,
    on_base_plate as on_base_plate,
    PROBLEMS as PROBLEMS,
    require_solid as require_solid,
)
from .files import (
    MeshFile as MeshFile,
    MeshFiles as MeshFiles,
    pack_mesh as pack_mesh,
    read_mesh as read_mesh,
    unpack_mesh as unpack_mesh,
    write_mesh as write_mesh,
)
from .mesh import (
    join_surfaces as join_surfaces,
    Mesh as Mesh,
    MeshLike as MeshLike,
    MM_PER_M as MM_PER_M,
)
from .box_tree import (
    connected as connected,
)
from .printability import (
    inspect as inspect,
    PrintReport as PrintReport,
    WARNINGS as WARNINGS,
    WARNINGS_PAGE as WARNINGS_PAGE,
)
from .mesh_options import (
    PrintProfile as PrintProfile,
    refuse_unit as refuse_unit,
    UNIT as UNIT,
)
from .raster import (
    MAX_PIXELS as MAX_PIXELS,
    highest_faces as highest_faces,
    highest_values as highest_values,
    positions_in_runs as positions_in_runs,
)
from .records import (
    FACES as FACES,
    flat_table as flat_table,
    MESH as MESH,
    MeshRow as MeshRow,
    RecordStream as RecordStream,
    require_mesh_columns as require_mesh_columns,
    SIZES as SIZES,
    SolidDataset as SolidDataset,
    SolidRecord as SolidRecord,
    VERTICES as VERTICES,
)
from .threemf import (
    BuildItem as BuildItem,
    read_build as read_build,
    write_build as write_build,
)
from .solid_tensors import (
    MeshBatch as MeshBatch,
    MeshItem as MeshItem,
    SolidTensors as SolidTensors,
    collate_meshes as collate_meshes,
)
