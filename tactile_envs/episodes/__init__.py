"""Episodes of policies: played, recorded as touches, replayed, and reported."""
