"""Procedural handwriting: hands, strokes, digits and ink, one file each.

::

    hand.py      uniform numbers that are the same on every machine; what stays the same in all digits of one
                 writer; which paths a digit can take, and which of them a writer prefers
    strokes.py   what the pen path of a digit is made of; from a few points to a smooth, evenly sampled path
    digits.py    the pen paths
    pen.py       from the unit square to the page (slant, size, position), and from paths to ink on paper
"""
