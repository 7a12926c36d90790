"""What a name stands for: where the data set lies, its kind, and the files of its splits."""
