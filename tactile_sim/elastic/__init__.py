"""An elastic gel: what it feels, and how its surface moves, when a body is pressed into it."""
