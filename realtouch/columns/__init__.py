"""From the columns of a file to the fields of rounds and touches."""
