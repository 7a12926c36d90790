"""Algorithm 1 of the Tactile MNIST paper, a file for each step."""
