"""Import of the recordings of others: touches are found, cut, given their fields, and stored."""
