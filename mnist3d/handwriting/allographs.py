"""The shapes in which writers draw each digit.

A shape is a function of `vary`, which gives a number its value for this writer and this digit, and of `pen`,
the pen width as a share of the height. It returns strokes. A stroke is a list of runs that join in corners.
A run is a list of points on a smooth curve. The top of a digit is near y = 0, its foot near y = 1, its left
edge near x = 0. A run may reach a little beyond, as the page scales the digit.
"""

from __future__ import annotations

from mnist3d.handwriting import five_to_nine, zero_to_four

ALLOGRAPHS = zero_to_four.ZERO_TO_FOUR + five_to_nine.FIVE_TO_NINE
"""For each digit its shapes, and the share of writers who prefer them; seeded digits depend on their order.

The shapes are those in MNIST and in collections of pen strokes. Means, spreads and shares were chosen so that
drawn digits are close to real ones (half of the MNIST test images and a few hundred pen digits;
``benchmarks/recognition.py``), with mostly bare 1s and open 4s, as North Americans write.
"""
