"""MNIST 3D: from images of handwritten digits to printable 3D meshes."""
