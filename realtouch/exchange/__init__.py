"""Touches in the formats of others: flat Parquet, WebDataset and LeRobot; and images of others as touches."""
