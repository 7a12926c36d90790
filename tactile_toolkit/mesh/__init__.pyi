"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .base_plate import on_base_plate as on_base_plate
from .files import (
    FORMATS as FORMATS,
    file_content as file_content,
    file_ending as file_ending,
    pack_mesh as pack_mesh,
    parse_mesh as parse_mesh,
    read_mesh as read_mesh,
    unpack_mesh as unpack_mesh,
    unit_of_file as unit_of_file,
    write_mesh as write_mesh,
)
from .welding import merge_equal_vertices as merge_equal_vertices
from .mesh_folders import (
    MeshFiles as MeshFiles,
    find_mesh_files as find_mesh_files,
)
from .mesh import (
    MM_PER_M as MM_PER_M,
    Mesh as Mesh,
    MeshLike as MeshLike,
    as_mesh as as_mesh,
    join_surfaces as join_surfaces,
)
from .nearness import (
    connected as connected,
)
from .print_cures import (
    WARNINGS_PAGE as WARNINGS_PAGE,
    explained as explained,
    print_advice as print_advice,
)
from .print_profile import (
    PrintProfile as PrintProfile,
)
from .print_report import (
    PrintReport as PrintReport,
    UNREADABLE as UNREADABLE,
    WARNINGS as WARNINGS,
    unreadable as unreadable,
)
from .printability import (
    inspect as inspect,
)
from .raster import (
    MAX_PIXELS as MAX_PIXELS,
    highest_faces as highest_faces,
    highest_values as highest_values,
    positions_in_runs as positions_in_runs,
)
from .mesh_columns import (
    FACES as FACES,
    MeshRow as MeshRow,
    VERTICES as VERTICES,
    mesh_metadata as mesh_metadata,
    mesh_schema as mesh_schema,
    require_mesh_columns as require_mesh_columns,
)
from .mesh_tables import (
    MESH as MESH,
    SIZES as SIZES,
    flat_table as flat_table,
)
from .records import (
    RecordStream as RecordStream,
    SolidDataset as SolidDataset,
    SolidRecord as SolidRecord,
)
from .crossings import (
    self_crossing as self_crossing,
)
from .solid_check import (
    PROBLEMS as PROBLEMS,
    ManifoldCheck as ManifoldCheck,
    array_problem as array_problem,
    check_manifold as check_manifold,
    require_solid as require_solid,
)
from .threemf import (
    read_build as read_build,
)
from .threemf_writing import (
    BuildItem as BuildItem,
    write_build as write_build,
)
from .solid_tensors import (
    MeshBatch as MeshBatch,
    MeshItem as MeshItem,
    REPRESENTATIONS as REPRESENTATIONS,
    SolidTensors as SolidTensors,
    TARGETS as TARGETS,
    collate_meshes as collate_meshes,
)
from .file_units import (
    UNIT as UNIT,
    refuse_unit as refuse_unit,
    require_unit as require_unit,
)
