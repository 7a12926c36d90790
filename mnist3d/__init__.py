"""MNIST 3D: from images of handwritten digits to printable 3D meshes.

``mnist3d.load`` opens a data set, ``mnist3d.generate`` makes one, ``mnist3d.solidify`` turns one image into a
mesh and ``mnist3d.inspect`` states whether a mesh prints. Names are imported on first use, so that
``import mnist3d`` costs nothing.
"""

from tactile_toolkit import on_first_use

__getattr__, __dir__, __all__ = on_first_use(__name__, __file__)
