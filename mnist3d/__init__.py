"""MNIST 3D: from images of handwritten digits to printable 3D meshes.

``mnist3d.load`` opens a data set, ``mnist3d.generate`` makes one, ``mnist3d.solidify`` turns one image into a
mesh and ``mnist3d.inspect`` states whether a mesh prints. Names are imported on first use, so that
``import mnist3d`` costs nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tactile_toolkit.lazy_names import on_first_use

if TYPE_CHECKING:
    from mnist3d.dataset import MeshDataset, MeshRecord, MeshStream, load
    from mnist3d.generation import GenerateSpec, generate
    from mnist3d.solid import SolidSpec, solidify
    from mnist3d.sources import DigitCatalog, DigitImage, DigitSource
    from mnist3d.splits import SPLITS, SplitSpec, plan_splits
    from tactile_toolkit.mesh.files import read_mesh, write_mesh
    from tactile_toolkit.mesh.mesh import Mesh
    from tactile_toolkit.mesh.printability import PrintProfile, PrintReport, inspect

__all__ = [
    "SPLITS",
    "DigitCatalog",
    "DigitImage",
    "DigitSource",
    "GenerateSpec",
    "Mesh",
    "MeshDataset",
    "MeshRecord",
    "MeshStream",
    "PrintProfile",
    "PrintReport",
    "SolidSpec",
    "SplitSpec",
    "generate",
    "inspect",
    "load",
    "plan_splits",
    "read_mesh",
    "solidify",
    "write_mesh",
]

__version__: str

__getattr__, __dir__ = on_first_use(
    __name__,
    {
        "mnist3d.dataset": ("MeshDataset", "MeshRecord", "MeshStream", "load"),
        "mnist3d.generation": ("GenerateSpec", "generate"),
        "mnist3d.solid": ("SolidSpec", "solidify"),
        "mnist3d.sources": ("DigitCatalog", "DigitImage", "DigitSource"),
        "mnist3d.splits": ("SPLITS", "SplitSpec", "plan_splits"),
        "tactile_toolkit.mesh.files": ("read_mesh", "write_mesh"),
        "tactile_toolkit.mesh.mesh": ("Mesh",),
        "tactile_toolkit.mesh.printability": ("PrintProfile", "PrintReport", "inspect"),
    },
)
