"""Pen paths of the digits 0 to 4; see :mod:`mnist3d.handwriting.allographs`."""

from __future__ import annotations

from mnist3d.handwriting.curves import CLEAR, Allographs, Point, Run, Stroke, Vary, arc


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
    right, corner = vary(0.519, 0.055), (vary(0.037, 0.034), 1.0)
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
    half, deep = vary(0.275, 0.035), 0.5 * (1.0 - waist[1])
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
    stem, bar = vary(0.378, 0.05), max(vary(0.597, 0.049), 0.36 + 1.9 * pen)
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
