"""Tables of other programs: one reader of text, JSON lines and Parquet; types and units of their columns."""
