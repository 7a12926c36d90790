"""Import of recordings from other programs: touches are found, cut, given their fields, and stored."""
