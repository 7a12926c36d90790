"""From Parquet through Arrow to numpy, lazily, and the data sets of records that users hold."""
