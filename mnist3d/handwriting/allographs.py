"""Pen paths of the digits, and how a few points become a smooth, evenly sampled path.

A shape is a function of `vary`, which gives a number its value for this writer and this digit, and of `pen`,
the pen width as a share of the height. It returns strokes; a stroke is a list of runs that join in corners; a
run is a list of points that a smooth curve passes through. The top of a digit is near y = 0, its foot near y
= 1, its left edge near x = 0. A run may reach a little beyond: the page scales what it gets.
"""

from __future__ import annotations

from mnist3d.handwriting.curves import Shape
from mnist3d.handwriting.five_to_nine import (
    eight_open,
    eight_s_first,
    eight_two_rings,
    eight_unclosed,
    five_one_stroke,
    five_round,
    five_with_bar,
    nine_curved,
    nine_g_shaped,
    nine_open,
    nine_straight,
    seven_crossed,
    seven_curved,
    seven_hooked,
    seven_plain,
    seven_serif,
    six_curled,
    six_curved,
    six_low,
    six_straight,
)
from mnist3d.handwriting.zero_to_four import (
    four_closed,
    four_low_stem,
    four_one_stroke,
    four_open,
    one_plain,
    one_with_flag,
    one_with_foot,
    one_with_upstroke,
    three_flat_topped,
    three_looped,
    three_round,
    two_angular,
    two_looped,
    two_round,
    two_swept,
    zero_flat,
    zero_narrow,
    zero_open,
    zero_overlapping,
    zero_round,
)

ALLOGRAPHS: tuple[tuple[tuple[Shape, float], ...], ...] = (
    ((zero_narrow, 0.30), (zero_round, 0.30), (zero_overlapping, 0.22), (zero_open, 0.10), (zero_flat, 0.08)),
    ((one_plain, 0.78), (one_with_flag, 0.10), (one_with_upstroke, 0.07), (one_with_foot, 0.05)),
    ((two_round, 0.32), (two_looped, 0.30), (two_angular, 0.20), (two_swept, 0.18)),
    ((three_round, 0.50), (three_looped, 0.30), (three_flat_topped, 0.20)),
    ((four_open, 0.50), (four_closed, 0.10), (four_one_stroke, 0.26), (four_low_stem, 0.14)),
    ((five_with_bar, 0.46), (five_one_stroke, 0.40), (five_round, 0.14)),
    ((six_curved, 0.40), (six_straight, 0.25), (six_curled, 0.12), (six_low, 0.23)),
    (
        (seven_plain, 0.30),
        (seven_crossed, 0.22),
        (seven_serif, 0.18),
        (seven_curved, 0.17),
        (seven_hooked, 0.13),
    ),
    ((eight_s_first, 0.40), (eight_two_rings, 0.10), (eight_open, 0.28), (eight_unclosed, 0.22)),
    ((nine_straight, 0.50), (nine_curved, 0.27), (nine_g_shaped, 0.08), (nine_open, 0.15)),
)
"""For each digit the shapes and the share of writers who prefer them; the order is part of what a seed gives.

The shapes are those seen in MNIST and in collections of pen strokes. Means, spreads and shares were chosen so
that digits drawn by them come near to real ones (half of the MNIST test images and a few hundred pen digits;
``benchmarks/recognition.py``), with mostly bare 1s and open 4s, as North Americans write.
"""
