"""Meshes, mesh files and print reports of the toolkit, exported again for users of digits."""

from tactile_toolkit.mesh import (
    Mesh as Mesh,
    PrintProfile as PrintProfile,
    PrintReport as PrintReport,
    inspect as inspect,
    read_mesh as read_mesh,
    write_mesh as write_mesh,
)
