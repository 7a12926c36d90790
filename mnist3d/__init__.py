"""MNIST 3D: from images of handwritten digits to printable 3D meshes.

``mnist3d.load`` opens a data set, ``mnist3d.generate`` makes one, ``mnist3d.solidify`` turns one image into a
mesh and ``mnist3d.inspect`` checks whether a mesh can be printed. Names are imported on first use, so that
``import mnist3d`` costs nothing.
"""

from lazy_loader import attach_stub

from tactile_toolkit import __version__ as __version__

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
