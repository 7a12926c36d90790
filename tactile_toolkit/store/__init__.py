"""A data set folder: shards, manifest, making it, resuming, replacing, verifying."""
