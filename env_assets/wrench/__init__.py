"""The wrench of the pose-estimation environments."""
