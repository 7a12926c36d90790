"""Algorithm 1 of the Tactile MNIST paper: the ink of a picture, the lattice, and the steps to a mesh."""
