"""New data sets of touches made from others."""
