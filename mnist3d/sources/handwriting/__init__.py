"""Procedural handwriting: chance, hands, glyphs, curves and ink, one file each.

::

    dice.py     uniform numbers that are the same on every machine
    hand.py     what stays the same in all digits of one writer
    glyphs.py   which shapes a digit can take, and which of them a writer prefers
    upper.py, lower.py   the pen paths of 0-4 and of 5-9
    curve.py    from a few points to a smooth, evenly sampled path
    pen.py      from paths to ink on paper
"""
