"""Data cards: the README of a data set folder, filled from the data at hand and checked against it."""
