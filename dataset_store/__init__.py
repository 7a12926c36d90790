"""What a stored data set is: columns, records, shards, manifest, runner, errors."""
