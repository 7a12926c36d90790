"""The shapes in which writers draw each digit.

A shape is a function of `vary`, which gives a number its value for this writer and this digit, and of `pen`,
the pen width as a share of the height. It returns strokes. A stroke is a list of runs that join in corners.
A run is a list of points on a smooth curve. The top of a digit is near y = 0, its foot near y = 1, its left
edge near x = 0. A run may reach a little beyond, as the page scales the digit.
"""

from __future__ import annotations

from mnist3d.sources.curves import CLEAR, Allographs, Point, Ring, Run, Stroke, Vary, arc, lean


def _oval(vary: Vary, pen: float, half: float, start_deg: float, over_deg: float) -> list[Stroke]:
    """Return a ring written anticlockwise that drifts while the pen goes round."""
    half = max(half, 0.5 * pen + CLEAR + 0.01)
    ring = arc((half, 0.5), (half, 0.5), start_deg, start_deg - 360.0 - over_deg, 15, vary(0.038, 0.07))
    drift_x, drift_y = vary(-0.01, 0.025), vary(0.025, 0.03)
    last = len(ring) - 1
    return [[[(x + drift_x * i / last, y + drift_y * i / last) for i, (x, y) in enumerate(ring)]]]


def zero_narrow(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a slim oval."""
    return _oval(vary, pen, vary(0.28, 0.035), vary(-76.2, 20.1), vary(2.0, 10.0))


def zero_round(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a wide oval."""
    return _oval(vary, pen, vary(0.361, 0.062), vary(-84.8, 22.5), vary(0.0, 10.0))


def zero_overlapping(vary: Vary, pen: float) -> list[Stroke]:
    """Draw an oval that begins and ends with a small overlap at the top right."""
    return _oval(vary, pen, vary(0.333, 0.058), vary(-62.6, 14.0), vary(22.7, 9.0))


def zero_open(vary: Vary, pen: float) -> list[Stroke]:
    """Draw an oval that does not close at the top."""
    return _oval(vary, pen, vary(0.346, 0.062), vary(-35.9, 31.2), min(vary(-22.1, 16.3), -8.0))


def zero_flat(vary: Vary, pen: float) -> list[Stroke]:
    """Draw an oval wider than it is tall."""
    return _oval(vary, pen, vary(0.483, 0.09), vary(-80.0, 25.0), vary(5.6, 12.0))


def one_plain(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a bare downstroke."""
    lean = vary(0.034, 0.145)
    return [[[(lean, 0.0), (vary(0.541, 0.103) * lean + vary(0.003, 0.013), 0.5), (0.0, 1.0)]]]


def _flag(vary: Vary, reach: float, drop: float) -> Stroke:
    """Return an upstroke from `drop` below the top and `reach` next to it, and a downstroke."""
    return [
        [(-reach, drop), (-0.45 * reach, 0.5 * drop + vary(-0.001, 0.02)), (0.0, 0.0)],
        [(0.0, 0.0), (vary(-0.021, 0.015), 0.5), (vary(-0.034, 0.047), 1.0)],
    ]


def one_with_flag(vary: Vary, pen: float) -> list[Stroke]:
    """Draw an upstroke and a downstroke."""
    return [_flag(vary, vary(0.152, 0.071), vary(0.477, 0.112))]


def one_with_upstroke(vary: Vary, pen: float) -> list[Stroke]:
    """Draw an upstroke nearly as long as the downstroke."""
    reach = max(vary(0.394, 0.088), 1.5 * pen)
    return [_flag(vary, reach, vary(0.947, 0.175))]


def one_with_foot(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a short upstroke, a downstroke and a bar below."""
    runs = _flag(vary, vary(0.18, 0.04), vary(0.18, 0.05))
    foot_x, foot_y = runs[-1][-1]
    half, tilt = vary(0.22, 0.04), vary(0.0, 0.015)
    return [runs, [[(foot_x - half, foot_y + tilt), (foot_x + half, foot_y - tilt)]]]


def _bow(vary: Vary, start_deg: float) -> Run:
    """Return the upper bow of a 2."""
    half, deep, left = vary(0.27, 0.052), vary(0.299, 0.058), vary(0.098, 0.07)
    return arc((left + half, deep), (half, deep), start_deg, vary(28.7, 15.8), 6)


def _slope(vary: Vary, start: Point, end: Point) -> Run:
    """Return two points on the way down from the bow of a 2, which bulges first and hollows then."""
    bulge, hollow = vary(0.042, 0.034), vary(-0.015, 0.025)
    return [
        (start[0] + share * (end[0] - start[0]) + aside, start[1] + share * (end[1] - start[1]))
        for share, aside in ((0.34, bulge), (0.72, hollow))
    ]


def _base(vary: Vary, corner: Point) -> Run:
    """Return the base of a 2, which some hands wave."""
    end = (vary(0.7, 0.14), 1.0 + vary(-0.058, 0.06))
    third = (end[0] - corner[0]) / 3.0
    wave = vary(-0.004, 0.023)
    return [
        corner,
        (corner[0] + third, 1.0 - wave + (end[1] - 1.0) / 3.0),
        (corner[0] + 2.0 * third, 1.0 + wave + 2.0 * (end[1] - 1.0) / 3.0),
        end,
    ]


def two_round(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a bow and a flat base that meet in a corner."""
    corner = (vary(0.02, 0.03), 1.0)
    bow = _bow(vary, max(vary(-174.6, 17.7), -185.0))
    return [[[*bow, *_slope(vary, bow[-1], corner), corner], _base(vary, corner)]]


def two_looped(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a 2 whose bow runs through a small loop into the base."""
    bow = _bow(vary, max(vary(-165.2, 17.0), -185.0))
    high = max(vary(0.126, 0.03), 0.5 * pen + 0.03)
    wide = max(vary(0.214, 0.059), 0.5 * pen + 0.06)
    loop = arc((wide, 1.0 - high), (wide, high), 75.0, 325.0, 6)
    reach = vary(0.256, 0.106)
    middle = (2.0 * wide + 0.3 * reach, vary(0.973, 0.023))
    end = (2.0 * wide + reach, vary(0.952, 0.05))
    return [[bow + _slope(vary, bow[-1], loop[0]) + loop + [middle, end]]]


def two_angular(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a 2 with a flat top, close to a Z."""
    right = vary(0.519, 0.055)
    corner = (vary(0.037, 0.034), 1.0)
    top = [(vary(0.02, 0.03), vary(0.094, 0.036)), (0.55 * right, 0.0), (right, vary(0.14, 0.03))]
    down = [(0.80 * right, vary(0.422, 0.03)), (0.45 * right, 0.72), corner]
    return [[top + down, _base(vary, corner)]]


def two_swept(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a small bow, a round turn at the left and a long swept base."""
    bow = _bow(vary, max(vary(-165.9, 20.2), -185.0))
    turn = [
        (vary(0.054, 0.04), vary(0.873, 0.042)),
        (vary(0.041, 0.033), vary(0.97, 0.02)),
        (vary(0.175, 0.034), 1.0),
    ]
    tail = [(vary(0.5, 0.08), vary(0.936, 0.03)), (vary(0.798, 0.136), vary(0.911, 0.06))]
    return [[bow + _slope(vary, bow[-1], turn[0]) + turn + tail]]


def _upper_bow(vary: Vary, start_deg: float) -> Run:
    """Return the upper bow of a 3 down to its waist."""
    half, deep, left = vary(0.202, 0.026), vary(0.211, 0.023), vary(0.003, 0.034)
    turn = arc((left + half, deep), (half * vary(1.096, 0.05), deep), start_deg, 62.0, 7)
    return [*turn, (left + half + vary(-0.052, 0.046), 2.0 * deep + 0.01)]


def _lower_bow(vary: Vary, waist: Point) -> Run:
    """Return the lower bow of a 3 from its waist on."""
    half = vary(0.275, 0.035)
    deep = 0.5 * (1.0 - waist[1])
    turn = arc((vary(0.243, 0.03), 1.0 - deep), (half, deep), -58.0, min(vary(142.8, 16.5), 170.0), 8)
    return [waist, *turn]


def three_round(vary: Vary, pen: float) -> list[Stroke]:
    """Draw two bows that meet in a corner."""
    upper = _upper_bow(vary, vary(-161.8, 17.7))
    return [[upper, _lower_bow(vary, upper[-1])]]


def three_looped(vary: Vary, pen: float) -> list[Stroke]:
    """Draw two bows joined by a small turn to the left."""
    upper = _upper_bow(vary, vary(-164.5, 17.6))
    x, y = upper.pop()
    return [[[*upper, (x - 0.05, y - 0.01), (x - 0.03, y + 0.035), *_lower_bow(vary, (x, y))[1:]]]]


def three_flat_topped(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a bar, a slanting stroke and a bow."""
    waist = (vary(0.189, 0.04), vary(0.403, 0.033))
    corner = (vary(0.495, 0.048), vary(0.007, 0.015))
    bar = [(vary(0.009, 0.03), vary(0.036, 0.02)), (0.25, vary(0.008, 0.012)), corner]
    return [[bar, [corner, waist], _lower_bow(vary, waist)]]


def four_open(vary: Vary, pen: float) -> list[Stroke]:
    """Draw an L with a stem through its bar, open at the top."""
    stem, bar, arm = vary(0.452, 0.045), vary(0.577, 0.054), vary(0.086, 0.056)
    corner = (vary(-0.003, 0.02), bar)
    down = [(arm, vary(0.051, 0.074)), (0.5 * arm + vary(-0.01, 0.015), 0.5 * bar), corner]
    across = [corner, (stem + vary(0.132, 0.054), bar - vary(0.023, 0.035))]
    upright = [
        (stem + vary(0.045, 0.046), vary(0.039, 0.077)),
        (stem, 0.5),
        (stem + vary(-0.011, 0.035), 1.0),
    ]
    return [[down, across], [upright]]


def four_closed(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a slanting stroke, a bar and a stem that close a triangle."""
    stem = vary(0.378, 0.05)
    bar = max(vary(0.597, 0.049), 0.36 + 1.9 * pen)
    corner = (vary(-0.02, 0.02) - 0.5 * pen, bar)
    down = [(stem, 0.0), (0.5 * (stem + corner[0]) + vary(0.001, 0.017), 0.5 * bar), corner]
    across = [corner, (stem + vary(0.139, 0.051), bar - vary(0.01, 0.025))]
    upright = [(stem, 0.0), (stem + vary(0.005, 0.016), 0.5), (stem + vary(-0.014, 0.029), 1.0)]
    return [[down, across], [upright]]


def four_one_stroke(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a rounded 4 in one go: down, across, up and down again."""
    right, bar = vary(0.489, 0.042), vary(0.582, 0.058)
    arm = (vary(0.073, 0.04), vary(0.03, 0.06))
    cup = [arm, (0.02, 0.5 * bar), (0.07, bar - 0.05), (0.20, bar), (right - 0.07, bar - 0.10)]
    top = (right + vary(0.036, 0.03), vary(0.036, 0.073))
    return [[[*cup, top], [top, (right, 0.5), (right + vary(-0.04, 0.046), 1.0)]]]


def four_low_stem(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a long arm and a bar, and a short stem that begins below the top."""
    bar, arm = vary(0.56, 0.046), vary(0.132, 0.062)
    stem = max(vary(0.323, 0.067), 1.5 * pen + 0.03)
    corner = (vary(-0.004, 0.023), bar)
    down = [(arm, 0.0), (0.35 * arm + vary(0.0, 0.015), 0.5 * bar), corner]
    across = [corner, (stem + max(vary(0.112, 0.08), 0.02), bar - vary(0.078, 0.057))]
    upright = [(stem + vary(0.059, 0.034), vary(0.2, 0.061)), (stem, 0.6), (stem + vary(-0.02, 0.035), 1.0)]
    return [[down, across], [upright]]


ZERO_TO_FOUR: Allographs = (
    ((zero_narrow, 0.30), (zero_round, 0.30), (zero_overlapping, 0.22), (zero_open, 0.10), (zero_flat, 0.08)),
    ((one_plain, 0.78), (one_with_flag, 0.10), (one_with_upstroke, 0.07), (one_with_foot, 0.05)),
    ((two_round, 0.32), (two_looped, 0.30), (two_angular, 0.20), (two_swept, 0.18)),
    ((three_round, 0.50), (three_looped, 0.30), (three_flat_topped, 0.20)),
    ((four_open, 0.50), (four_closed, 0.10), (four_one_stroke, 0.26), (four_low_stem, 0.14)),
)


def _belly(vary: Vary, neck: Point) -> Run:
    """Return the bow of a 5 from its neck on."""
    half = vary(0.273, 0.045)
    deep = 0.5 * (1.0 - neck[1]) + vary(0.018, 0.01)
    # Further round, the end would close on the neck and the 5 would be a 6.
    start_deg = vary(-90.0, 14.0)
    end_deg = min(vary(149.1, 21.7), 162.0)
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
    corner = (vary(0.579, 0.068), vary(0.006, 0.051))
    foot = (vary(0.28, 0.08), 1.0)
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
    right = middle + half
    low = vary(0.17, 0.03)
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
ALLOGRAPHS = ZERO_TO_FOUR + FIVE_TO_NINE
"""For each digit its shapes, and the share of writers who prefer them; seeded digits depend on their order.

The shapes are those in MNIST and in collections of pen strokes. Means, spreads and shares were chosen so that
drawn digits are close to real ones (half of the MNIST test images and a few hundred pen digits;
``benchmarks/recognition.py``), with mostly bare 1s and open 4s, as North Americans write.
"""
