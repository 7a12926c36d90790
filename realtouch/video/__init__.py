"""Videos: the clips of touches, and files of other programs."""
