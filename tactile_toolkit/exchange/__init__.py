"""Data sets on their way: to the Hub, from it, and into other formats."""
