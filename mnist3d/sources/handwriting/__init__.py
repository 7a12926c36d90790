"""Procedural handwriting: chance, hands, glyphs, curves and ink, one file each.

::

    dice.py     uniform numbers that are the same on every machine
    hand.py     what stays the same in all digits of one writer
    shape.py    what the pen path of a digit is made of
    digits_0_to_4.py, digits_5_to_9.py   the pen paths
    glyphs.py   which paths a digit can take, and which of them a writer prefers
    curve.py    from a few points to a smooth, evenly sampled path
    pose.py     from the unit square to the page: slant, size, place
    pen.py      from paths to ink on paper
"""
