"""Pen paths of the digits 5 to 9; see :mod:`mnist3d.handwriting.allographs`."""

from __future__ import annotations

from mnist3d.handwriting.curves import CLEAR, Allographs, Point, Ring, Run, Stroke, Vary, arc, lean


def _belly(vary: Vary, neck: Point) -> Run:
    """Return the bow of a 5 from its neck on."""
    half, deep = vary(0.273, 0.045), 0.5 * (1.0 - neck[1]) + vary(0.018, 0.01)
    # Further round, the end would close on the neck and the 5 would be a 6.
    start_deg, end_deg = vary(-90.0, 14.0), min(vary(149.1, 21.7), 162.0)
    turn = arc((vary(0.2, 0.049), 1.0 - deep), (half, deep), start_deg, end_deg, 8)
    return [neck, *turn]


def five_with_bar(vary: Vary, pen: float) -> list[Stroke]:
    """Draw neck and belly, then a bar on top as a stroke of its own."""
    neck = (vary(0.044, 0.035), vary(0.45, 0.055))
    top = (vary(0.141, 0.068), vary(0.031, 0.02))
    bar = [(top[0] - vary(0.01, 0.01), top[1] + vary(0.01, 0.01)), (vary(0.658, 0.109), vary(-0.016, 0.046))]
    return [[[top, neck], _belly(vary, neck)], [bar]]


def five_one_stroke(vary: Vary, pen: float) -> list[Stroke]:
    """Draw bar, neck and belly without lifting the pen."""
    neck = (vary(0.05, 0.03), vary(0.452, 0.053))
    top = (vary(0.158, 0.067), vary(0.033, 0.02))
    end = (vary(0.686, 0.118), vary(-0.007, 0.035))
    bar = [end, (0.5 * (end[0] + top[0]), 0.5 * (end[1] + top[1]) + vary(0.004, 0.012)), top]
    return [[bar, [top, neck], _belly(vary, neck)]]


def five_round(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a 5 that is close to an S."""
    head = [(vary(0.589, 0.087), vary(-0.008, 0.03)), (0.28, vary(0.01, 0.01)), (vary(0.09, 0.02), 0.13)]
    neck = (vary(0.079, 0.034), vary(0.365, 0.035))
    return [[[*head, neck, *_belly(vary, (neck[0], neck[1] + 0.03))[2:]]]]


def _bowl(vary: Vary, pen: float, left: float) -> Run:
    """Return the ring of a 6, from its left round by the foot and back to the stem."""
    half = max(vary(0.243, 0.046), 0.5 * pen + CLEAR + 0.02)
    deep = max(vary(0.196, 0.03), 0.5 * pen + CLEAR + 0.01)
    ring = arc((left + half, 1.0 - deep), (half, deep), 150.0, vary(-165.0, 16.0), 11)
    return lean(ring, vary(0.192, 0.123), 1.0 - deep)


def six_curved(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a bowed stem that runs into the ring."""
    left = vary(0.016, 0.023)
    stem = [(vary(0.323, 0.068), 0.0), (vary(0.173, 0.041), vary(0.231, 0.03)), (left + 0.03, 0.54)]
    return [[stem + _bowl(vary, pen, left)]]


def six_straight(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a nearly straight stem with a ring."""
    left = vary(0.016, 0.024)
    stem = [(vary(0.242, 0.074), 0.0), (vary(0.129, 0.036), 0.28), (left + 0.03, 0.58)]
    return [[stem + _bowl(vary, pen, left)]]


def six_curled(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a C with a ring whose end closes on the stem."""
    left = vary(-0.002, 0.02)
    tip = (vary(0.344, 0.062), vary(0.088, 0.037))
    stem = [tip, (vary(0.318, 0.034), 0.0), (vary(0.114, 0.034), 0.22), (left, 0.54)]
    return [[stem + _bowl(vary, pen, left)]]


def six_low(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a long bowed stem that ends in a wide, flat ring."""
    half = max(vary(0.266, 0.047), 0.5 * pen + CLEAR + 0.02)
    deep = max(vary(0.166, 0.035), 0.5 * pen + CLEAR)
    stem = [
        (vary(0.274, 0.097), 0.0),
        (vary(0.09, 0.033), vary(0.33, 0.04)),
        (vary(-0.002, 0.021), vary(0.7, 0.03)),
    ]
    ring = arc((vary(0.063, 0.03) + half, 1.0 - deep), (half, deep), 140.0, vary(-144.1, 22.0), 10)
    return [[stem + ring]]


def _seven(vary: Vary) -> tuple[Run, Run]:
    """Return bar and stem of a 7."""
    corner, foot = (vary(0.579, 0.068), vary(0.006, 0.051)), (vary(0.28, 0.08), 1.0)
    start = (vary(-0.007, 0.04), vary(0.03, 0.048))
    bar = [start, (0.5 * corner[0], 0.5 * (start[1] + corner[1]) + vary(-0.005, 0.015)), corner]
    middle = (vary(0.553, 0.06), 0.5)
    return bar, [corner, (foot[0] + middle[0] * (corner[0] - foot[0]) - 0.04, middle[1]), foot]


def seven_plain(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a bar and a stem."""
    return [list(_seven(vary))]


def seven_crossed(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a 7 with a short bar through its stem."""
    bar, stem = _seven(vary)
    x, y = stem[1]
    half, rise = vary(0.191, 0.05), vary(0.024, 0.025)
    return [[bar, stem], [[(x - half, y + 0.02 + rise), (x + half, y + 0.02 - rise)]]]


def seven_serif(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a 7 whose bar begins with a tick."""
    bar, stem = _seven(vary)
    start = (bar[0][0] - vary(0.01, 0.01), bar[0][1] + vary(0.127, 0.058))
    return [[[start, bar[0]], bar, stem]]


def seven_curved(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a 7 in one bend, without a corner."""
    hook = (vary(0.012, 0.034), vary(0.138, 0.1))
    top = [(vary(0.115, 0.03), vary(0.046, 0.03)), (vary(0.324, 0.062), vary(0.012, 0.02))]
    bend = [(vary(0.513, 0.04), vary(0.085, 0.032)), (vary(0.575, 0.05), vary(0.26, 0.05))]
    return [[[hook, *top, *bend, (vary(0.445, 0.05), vary(0.613, 0.04)), (vary(0.28, 0.084), 1.0)]]]


def seven_hooked(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a 7 that begins with a deep hook."""
    bar, stem = _seven(vary)
    start = (bar[0][0] + vary(0.019, 0.036), bar[0][1] + vary(0.275, 0.071))
    return [[[start, bar[0], (bar[0][0] + vary(0.108, 0.03), bar[0][1] - vary(0.02, 0.02)), *bar[1:]], stem]]


def _rings(vary: Vary, pen: float) -> tuple[Ring, Ring]:
    """Return the upper and the lower ring of an 8."""
    waist = vary(0.499, 0.046)
    upper = max(vary(0.195, 0.035), 0.5 * pen + 0.8 * CLEAR)
    lower = max(vary(0.153, 0.034), 0.5 * pen + 0.8 * CLEAR)
    x = vary(0.24, 0.01)
    top = ((x + vary(0.003, 0.054), 0.5 * waist), (upper, 0.5 * waist))
    return top, ((x, 0.5 * (1.0 + waist)), (lower, 0.5 * (1.0 - waist)))


def _figure_eight(vary: Vary, upper: Ring, lower: Ring, start_deg: float, stop_deg: float) -> Run:
    """Return an S through both rings and the way back up to the start.

    The earlier the pen leaves a ring, the more its two halves cross like an X.
    """
    cross = vary(31.3, 8.0)
    descent = arc(*upper, start_deg, -180.0 - cross, 7)
    bowl = arc(*lower, -cross, 180.0 + cross, 8)
    return descent + bowl + arc(*upper, cross, stop_deg, 4)


def eight_s_first(vary: Vary, pen: float) -> list[Stroke]:
    """Draw an S and return upward across it."""
    upper, lower = _rings(vary, pen)
    return [[_figure_eight(vary, upper, lower, vary(-36.1, 13.4), vary(-45.0, 14.0))]]


def eight_two_rings(vary: Vary, pen: float) -> list[Stroke]:
    """Draw one ring on another."""
    upper, lower = _rings(vary, pen)
    over = vary(6.7, 8.0)
    return [
        [arc(*upper, 90.0, -270.0 - over, 12)],
        [arc(*lower, vary(-78.5, 15.0), -445.0 - over, 12)],
    ]


def eight_open(vary: Vary, pen: float) -> list[Stroke]:
    """Draw an 8 whose two ends cross or miss each other at the top right."""
    upper, lower = _rings(vary, pen)
    path = _figure_eight(vary, upper, lower, vary(-45.0, 13.0), 8.0)
    (x, y), (wide, _) = upper
    path[-2:] = [(x + 0.9 * wide, y - 0.02), (x + wide + vary(0.06, 0.03), vary(0.046, 0.039))]
    return [[path]]


def eight_unclosed(vary: Vary, pen: float) -> list[Stroke]:
    """Draw an S that comes back up but ends short of where it began."""
    upper, lower = _rings(vary, pen)
    path = _figure_eight(vary, upper, lower, vary(-69.6, 20.4), vary(0.9, 14.0))
    (x, y), (wide, deep) = upper
    return [[[(x + vary(0.876, 0.15) * wide, y - vary(0.557, 0.214) * deep), *path[1:]]]]


def _head(vary: Vary, pen: float) -> Run:
    """Return the ring of a 9, from its right shoulder round to the right again."""
    half = max(vary(0.22, 0.031), 0.5 * pen + CLEAR)
    deep = max(vary(0.237, 0.031), 0.5 * pen + CLEAR)
    slant = vary(0.24, 0.133)
    ring = arc((half, deep), (half, deep), vary(-36.6, 15.0), -320.0, 9)
    return [*lean(ring, slant, deep), (2.0 * half + vary(0.009, 0.022), vary(0.131, 0.07))]


def nine_straight(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a ring and a straight stem."""
    ring = _head(vary, pen)
    x, _ = ring[-1]
    foot = vary(-0.081, 0.067)
    return [[ring, [ring[-1], (x + 0.5 * foot + vary(-0.003, 0.016), 0.55), (x + foot, 1.0)]]]


def nine_curved(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a ring and a stem that bends to the left."""
    ring = _head(vary, pen)
    x, _ = ring[-1]
    return [[ring, [ring[-1], (x - vary(0.02, 0.015), 0.55), (vary(0.276, 0.056), 1.0)]]]


def nine_g_shaped(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a slim ring and a stem that curls back below it like a g."""
    half = max(vary(0.125, 0.025), 0.5 * pen + 0.4 * CLEAR)
    deep = max(vary(0.213, 0.03), 0.5 * pen + 0.8 * CLEAR)
    middle, slant = vary(0.224, 0.04), vary(0.155, 0.111)
    ring = arc((middle, deep), (half, deep), vary(-29.6, 15.0), -325.0, 9)
    right, low = middle + half, vary(0.17, 0.03)
    belly = right + vary(0.056, 0.05)
    hook = arc((0.5 * belly, 1.0 - low), (0.5 * belly, low), 5.0, vary(154.3, 27.0), 6)
    start = (right + 0.5 * slant * deep, vary(0.098, 0.053))
    return [[lean(ring, slant, deep), [start, (right + 0.2 * (belly - right), 0.48), *hook]]]


def nine_open(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a cup that stays open at the top and a stem next to it."""
    half = max(vary(0.226, 0.031), 0.5 * pen + CLEAR)
    deep = max(vary(0.236, 0.031), 0.5 * pen + CLEAR)
    cup = lean(arc((half, deep), (half, deep), vary(-57.3, 16.0), -345.0, 9), vary(0.271, 0.12), deep)
    top = (2.0 * half + vary(0.027, 0.02), vary(0.114, 0.058))
    foot = vary(-0.05, 0.06)
    stem = [top, (top[0] + 0.5 * foot + vary(-0.005, 0.015), 0.55), (top[0] + foot, 1.0)]
    return [[[*cup, top], stem]]


FIVE_TO_NINE: Allographs = (
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
