"""Published data sets, and where a data set of a given name lies."""
