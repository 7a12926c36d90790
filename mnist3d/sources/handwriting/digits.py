"""Pen paths of the digits; :mod:`mnist3d.sources.handwriting.strokes` has the conventions."""

from __future__ import annotations

from mnist3d.sources.handwriting.strokes import CLEAR, Point, Ring, Run, Stroke, Vary, arc, lean

__all__ = [
    "eight_open",
    "eight_s_first",
    "eight_two_rings",
    "five_one_stroke",
    "five_round",
    "five_with_bar",
    "four_closed",
    "four_low_stem",
    "four_one_stroke",
    "four_open",
    "nine_curved",
    "nine_g_shaped",
    "nine_straight",
    "one_plain",
    "one_with_flag",
    "one_with_foot",
    "one_with_upstroke",
    "seven_crossed",
    "seven_plain",
    "seven_serif",
    "six_curled",
    "six_curved",
    "six_straight",
    "three_flat_topped",
    "three_looped",
    "three_round",
    "two_angular",
    "two_looped",
    "two_round",
    "zero_narrow",
    "zero_overlapping",
    "zero_round",
]


def _oval(vary: Vary, pen: float, half: float, start_deg: float, over_deg: float) -> list[Stroke]:
    """Return a ring written anticlockwise that drifts while the pen goes round."""
    half = max(half, 0.5 * pen + CLEAR + 0.01)
    ring = arc((half, 0.5), (half, 0.5), start_deg, start_deg - 360.0 - over_deg, 15, vary(0.0, 0.07))
    drift_x, drift_y = vary(-0.01, 0.025), vary(0.025, 0.03)
    last = len(ring) - 1
    return [[[(x + drift_x * i / last, y + drift_y * i / last) for i, (x, y) in enumerate(ring)]]]


def zero_narrow(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a slim oval."""
    return _oval(vary, pen, vary(0.27, 0.035), vary(-80.0, 18.0), vary(2.0, 10.0))


def zero_round(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a wide oval."""
    return _oval(vary, pen, vary(0.40, 0.05), vary(-80.0, 22.0), vary(0.0, 10.0))


def zero_overlapping(vary: Vary, pen: float) -> list[Stroke]:
    """Draw an oval that begins and ends with a small overlap at the top right."""
    return _oval(vary, pen, vary(0.34, 0.05), vary(-60.0, 14.0), vary(22.0, 9.0))


def one_plain(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a bare downstroke."""
    lean = vary(0.07, 0.13)
    return [[[(lean, 0.0), (vary(0.5, 0.1) * lean + vary(0.0, 0.012), 0.5), (0.0, 1.0)]]]


def _flag(vary: Vary, reach: float, drop: float) -> Stroke:
    """Return an upstroke from `drop` below the top and `reach` beside it, and a downstroke."""
    return [
        [(-reach, drop), (-0.45 * reach, 0.5 * drop + vary(0.0, 0.02)), (0.0, 0.0)],
        [(0.0, 0.0), (vary(-0.01, 0.015), 0.5), (vary(-0.03, 0.04), 1.0)],
    ]


def one_with_flag(vary: Vary, pen: float) -> list[Stroke]:
    """Draw an upstroke and a downstroke."""
    return [_flag(vary, vary(0.26, 0.06), vary(0.38, 0.09))]


def one_with_upstroke(vary: Vary, pen: float) -> list[Stroke]:
    """Draw an upstroke nearly as long as the downstroke."""
    reach = max(vary(0.40, 0.07), 1.5 * pen)
    return [_flag(vary, reach, vary(0.72, 0.14))]


def one_with_foot(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a short upstroke, a downstroke and a bar below."""
    runs = _flag(vary, vary(0.18, 0.04), vary(0.18, 0.05))
    foot_x, foot_y = runs[-1][-1]
    half, tilt = vary(0.22, 0.04), vary(0.0, 0.015)
    return [runs, [[(foot_x - half, foot_y + tilt), (foot_x + half, foot_y - tilt)]]]


def _bow(vary: Vary, start_deg: float) -> Run:
    """Return the upper bow of a 2."""
    half, deep, left = vary(0.25, 0.045), vary(0.25, 0.05), vary(0.07, 0.06)
    return arc((left + half, deep), (half, deep), start_deg, vary(25.0, 14.0), 6)


def _slope(vary: Vary, start: Point, end: Point) -> Run:
    """Return two points on the way down from the bow of a 2, which bulges first and hollows then."""
    bulge, hollow = vary(0.025, 0.03), vary(-0.015, 0.025)
    return [
        (start[0] + share * (end[0] - start[0]) + aside, start[1] + share * (end[1] - start[1]))
        for share, aside in ((0.34, bulge), (0.72, hollow))
    ]


def _base(vary: Vary, corner: Point) -> Run:
    """Return the base of a 2, which some hands wave."""
    end = (vary(0.70, 0.12), 1.0 + vary(-0.02, 0.05))
    third = (end[0] - corner[0]) / 3.0
    wave = vary(0.0, 0.02)
    return [
        corner,
        (corner[0] + third, 1.0 - wave + (end[1] - 1.0) / 3.0),
        (corner[0] + 2.0 * third, 1.0 + wave + 2.0 * (end[1] - 1.0) / 3.0),
        end,
    ]


def two_round(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a bow and a flat base that meet in a corner."""
    corner = (vary(0.02, 0.03), 1.0)
    bow = _bow(vary, max(vary(-165.0, 15.0), -185.0))
    return [[[*bow, *_slope(vary, bow[-1], corner), corner], _base(vary, corner)]]


def two_angular(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a 2 with a flat top, near to a Z."""
    right, corner = vary(0.50, 0.05), (vary(0.02, 0.03), 1.0)
    top = [(vary(0.02, 0.03), vary(0.08, 0.03)), (0.55 * right, 0.0), (right, vary(0.14, 0.03))]
    down = [(0.80 * right, vary(0.42, 0.03)), (0.45 * right, 0.72), corner]
    return [[top + down, _base(vary, corner)]]


def two_looped(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a 2 whose bow runs through a small loop into the base."""
    bow = _bow(vary, max(vary(-170.0, 15.0), -185.0))
    high = max(vary(0.11, 0.03), 0.5 * pen + 0.03)
    wide = max(vary(0.17, 0.05), 0.5 * pen + 0.06)
    loop = arc((wide, 1.0 - high), (wide, high), 75.0, 325.0, 6)
    reach = vary(0.36, 0.09)
    middle = (2.0 * wide + 0.3 * reach, vary(0.97, 0.02))
    end = (2.0 * wide + reach, vary(0.95, 0.05))
    return [[bow + _slope(vary, bow[-1], loop[0]) + loop + [middle, end]]]


def _upper_bow(vary: Vary, start_deg: float) -> Run:
    """Return the upper bow of a 3 down to its waist."""
    half, deep, left = vary(0.20, 0.025), vary(0.22, 0.02), vary(0.02, 0.03)
    turn = arc((left + half, deep), (half * vary(1.1, 0.05), deep), start_deg, 62.0, 7)
    return [*turn, (left + half + vary(-0.04, 0.04), 2.0 * deep + 0.01)]


def _lower_bow(vary: Vary, waist: Point) -> Run:
    """Return the lower bow of a 3 from its waist on."""
    half, deep = vary(0.26, 0.03), 0.5 * (1.0 - waist[1])
    turn = arc((vary(0.24, 0.03), 1.0 - deep), (half, deep), -58.0, min(vary(150.0, 14.0), 170.0), 8)
    return [waist, *turn]


def three_round(vary: Vary, pen: float) -> list[Stroke]:
    """Draw two bows that meet in a corner."""
    upper = _upper_bow(vary, vary(-155.0, 16.0))
    return [[upper, _lower_bow(vary, upper[-1])]]


def three_flat_topped(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a bar, a slanting stroke and a bow."""
    waist = (vary(0.20, 0.04), vary(0.40, 0.03))
    corner = (vary(0.48, 0.04), vary(0.01, 0.015))
    bar = [(vary(0.02, 0.03), vary(0.03, 0.02)), (0.25, vary(0.01, 0.01)), corner]
    return [[bar, [corner, waist], _lower_bow(vary, waist)]]


def three_looped(vary: Vary, pen: float) -> list[Stroke]:
    """Draw two bows joined by a small turn to the left."""
    upper = _upper_bow(vary, vary(-160.0, 16.0))
    x, y = upper.pop()
    return [[[*upper, (x - 0.05, y - 0.01), (x - 0.03, y + 0.035), *_lower_bow(vary, (x, y))[1:]]]]


def four_open(vary: Vary, pen: float) -> list[Stroke]:
    """Draw an L with a stem through its bar, open at the top."""
    stem, bar, arm = vary(0.44, 0.04), vary(0.56, 0.05), vary(0.09, 0.05)
    corner = (vary(0.0, 0.02), bar)
    down = [(arm, vary(0.06, 0.06)), (0.5 * arm + vary(-0.01, 0.015), 0.5 * bar), corner]
    across = [corner, (stem + vary(0.17, 0.05), bar - vary(0.02, 0.035))]
    upright = [(stem + vary(0.03, 0.04), vary(0.05, 0.07)), (stem, 0.5), (stem + vary(-0.02, 0.035), 1.0)]
    return [[down, across], [upright]]


def four_low_stem(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a long arm and a bar, and a short stem that begins below the top."""
    bar, arm = vary(0.55, 0.04), vary(0.13, 0.05)
    stem = max(vary(0.28, 0.06), 1.5 * pen + 0.03)
    corner = (vary(0.0, 0.02), bar)
    down = [(arm, 0.0), (0.35 * arm + vary(0.0, 0.015), 0.5 * bar), corner]
    across = [corner, (stem + max(vary(0.17, 0.07), 0.02), bar - vary(0.04, 0.05))]
    upright = [(stem + vary(0.04, 0.03), vary(0.24, 0.06)), (stem, 0.6), (stem + vary(-0.02, 0.035), 1.0)]
    return [[down, across], [upright]]


def four_closed(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a slanting stroke, a bar and a stem that close a triangle."""
    stem, bar = vary(0.42, 0.04), max(vary(0.64, 0.04), 0.36 + 1.9 * pen)
    corner = (vary(-0.02, 0.02) - 0.5 * pen, bar)
    down = [(stem, 0.0), (0.5 * (stem + corner[0]) + vary(-0.01, 0.015), 0.5 * bar), corner]
    across = [corner, (stem + vary(0.19, 0.05), bar - vary(0.01, 0.025))]
    upright = [(stem, 0.0), (stem + vary(0.0, 0.015), 0.5), (stem + vary(-0.01, 0.025), 1.0)]
    return [[down, across], [upright]]


def four_one_stroke(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a rounded 4 in one go: down, across, up and down again."""
    right, bar = vary(0.46, 0.04), vary(0.52, 0.05)
    arm = (vary(0.07, 0.04), vary(0.04, 0.05))
    cup = [arm, (0.02, 0.5 * bar), (0.07, bar - 0.05), (0.20, bar), (right - 0.07, bar - 0.10)]
    top = (right + vary(0.03, 0.03), vary(0.06, 0.06))
    return [[[*cup, top], [top, (right, 0.5), (right + vary(-0.05, 0.04), 1.0)]]]


def _belly(vary: Vary, neck: Point) -> Run:
    """Return the bow of a 5 from its neck on."""
    half, deep = vary(0.25, 0.04), 0.5 * (1.0 - neck[1]) + vary(0.02, 0.01)
    # Further round, the end would close on the neck and the 5 would be a 6.
    start_deg, end_deg = vary(-90.0, 14.0), min(vary(145.0, 18.0), 162.0)
    turn = arc((vary(0.20, 0.04), 1.0 - deep), (half, deep), start_deg, end_deg, 8)
    return [neck, *turn]


def five_with_bar(vary: Vary, pen: float) -> list[Stroke]:
    """Draw neck and belly, then a bar on top as a stroke of its own."""
    neck = (vary(0.05, 0.03), vary(0.45, 0.05))
    top = (vary(0.16, 0.06), vary(0.03, 0.02))
    bar = [(top[0] - vary(0.01, 0.01), top[1] + vary(0.01, 0.01)), (vary(0.62, 0.10), vary(-0.01, 0.04))]
    return [[[top, neck], _belly(vary, neck)], [bar]]


def five_one_stroke(vary: Vary, pen: float) -> list[Stroke]:
    """Draw bar, neck and belly without lifting the pen."""
    neck = (vary(0.05, 0.03), vary(0.44, 0.05))
    top = (vary(0.15, 0.06), vary(0.03, 0.02))
    end = (vary(0.62, 0.10), vary(-0.01, 0.035))
    bar = [end, (0.5 * (end[0] + top[0]), 0.5 * (end[1] + top[1]) + vary(0.005, 0.012)), top]
    return [[bar, [top, neck], _belly(vary, neck)]]


def five_round(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a 5 near to an S."""
    head = [(vary(0.56, 0.07), vary(0.01, 0.03)), (0.28, vary(0.01, 0.01)), (vary(0.09, 0.02), 0.13)]
    neck = (vary(0.08, 0.03), vary(0.36, 0.03))
    return [[[*head, neck, *_belly(vary, (neck[0], neck[1] + 0.03))[2:]]]]


def _bowl(vary: Vary, pen: float, left: float) -> Run:
    """Return the ring of a 6, from its left round by the foot and back to the stem."""
    half = max(vary(0.235, 0.04), 0.5 * pen + CLEAR + 0.02)
    deep = max(vary(0.22, 0.03), 0.5 * pen + CLEAR + 0.01)
    ring = arc((left + half, 1.0 - deep), (half, deep), 150.0, vary(-165.0, 16.0), 11)
    return lean(ring, vary(0.12, 0.10), 1.0 - deep)


def six_curved(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a bowed stem that runs into the ring."""
    left = vary(0.02, 0.02)
    stem = [(vary(0.33, 0.07), 0.0), (vary(0.15, 0.035), vary(0.23, 0.03)), (left + 0.03, 0.54)]
    return [[stem + _bowl(vary, pen, left)]]


def six_straight(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a nearly straight stem with a ring."""
    left = vary(0.02, 0.02)
    stem = [(vary(0.20, 0.08), 0.0), (vary(0.11, 0.03), 0.28), (left + 0.03, 0.58)]
    return [[stem + _bowl(vary, pen, left)]]


def six_curled(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a C with a ring whose end closes on the stem."""
    left = vary(0.0, 0.02)
    tip = (vary(0.42, 0.05), vary(0.08, 0.03))
    stem = [tip, (vary(0.30, 0.03), 0.0), (vary(0.10, 0.03), 0.22), (left, 0.54)]
    return [[stem + _bowl(vary, pen, left)]]


def _seven(vary: Vary) -> tuple[Run, Run]:
    """Return bar and stem of a 7."""
    corner, foot = (vary(0.58, 0.06), vary(0.02, 0.045)), (vary(0.26, 0.08), 1.0)
    start = (vary(0.0, 0.04), vary(0.05, 0.04))
    bar = [start, (0.5 * corner[0], 0.5 * (start[1] + corner[1]) + vary(-0.005, 0.015)), corner]
    middle = (vary(0.55, 0.06), 0.5)
    return bar, [corner, (foot[0] + middle[0] * (corner[0] - foot[0]) - 0.04, middle[1]), foot]


def seven_plain(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a bar and a stem."""
    return [list(_seven(vary))]


def seven_crossed(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a 7 with a short bar through its stem."""
    bar, stem = _seven(vary)
    x, y = stem[1]
    half, rise = vary(0.18, 0.04), vary(0.01, 0.025)
    return [[bar, stem], [[(x - half, y + 0.02 + rise), (x + half, y + 0.02 - rise)]]]


def seven_serif(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a 7 whose bar begins with a tick."""
    bar, stem = _seven(vary)
    start = (bar[0][0] - vary(0.01, 0.01), bar[0][1] + vary(0.15, 0.05))
    return [[[start, bar[0]], bar, stem]]


def _rings(vary: Vary, pen: float) -> tuple[Ring, Ring]:
    """Return the upper and the lower ring of an 8."""
    waist = vary(0.51, 0.04)
    upper = max(vary(0.18, 0.028), 0.5 * pen + 0.8 * CLEAR)
    lower = max(vary(0.165, 0.028), 0.5 * pen + 0.8 * CLEAR)
    x = vary(0.24, 0.01)
    top = ((x + vary(0.05, 0.045), 0.5 * waist), (upper, 0.5 * waist))
    return top, ((x, 0.5 * (1.0 + waist)), (lower, 0.5 * (1.0 - waist)))


def _figure_eight(vary: Vary, upper: Ring, lower: Ring, start_deg: float, stop_deg: float) -> Run:
    """Return an S through both rings and the way back up to the start.

    The earlier the pen leaves a ring, the more its two halves cross like an X.
    """
    cross = vary(36.0, 8.0)
    descent = arc(*upper, start_deg, -180.0 - cross, 7)
    bowl = arc(*lower, -cross, 180.0 + cross, 8)
    return descent + bowl + arc(*upper, cross, stop_deg, 4)


def eight_s_first(vary: Vary, pen: float) -> list[Stroke]:
    """Draw an S and return upward across it."""
    upper, lower = _rings(vary, pen)
    return [[_figure_eight(vary, upper, lower, vary(-38.0, 12.0), vary(-45.0, 14.0))]]


def eight_open(vary: Vary, pen: float) -> list[Stroke]:
    """Draw an 8 whose two ends cross or miss each other at the top right."""
    upper, lower = _rings(vary, pen)
    path = _figure_eight(vary, upper, lower, vary(-48.0, 12.0), 8.0)
    (x, y), (wide, _) = upper
    path[-2:] = [(x + 0.9 * wide, y - 0.02), (x + wide + vary(0.06, 0.03), vary(0.06, 0.035))]
    return [[path]]


def eight_two_rings(vary: Vary, pen: float) -> list[Stroke]:
    """Draw one ring on another."""
    upper, lower = _rings(vary, pen)
    over = vary(5.0, 8.0)
    return [
        [arc(*upper, 90.0, -270.0 - over, 12)],
        [arc(*lower, vary(-85.0, 15.0), -445.0 - over, 12)],
    ]


def _head(vary: Vary, pen: float) -> Run:
    """Return the ring of a 9, from its right shoulder round to the right again."""
    half = max(vary(0.21, 0.03), 0.5 * pen + CLEAR)
    deep = max(vary(0.245, 0.03), 0.5 * pen + CLEAR)
    slant = vary(0.20, 0.12)
    ring = arc((half, deep), (half, deep), vary(-35.0, 15.0), -320.0, 9)
    return [*lean(ring, slant, deep), (2.0 * half + vary(0.02, 0.02), vary(0.12, 0.06))]


def nine_straight(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a ring and a straight stem."""
    ring = _head(vary, pen)
    x, _ = ring[-1]
    foot = vary(-0.06, 0.06)
    return [[ring, [ring[-1], (x + 0.5 * foot + vary(0.0, 0.015), 0.55), (x + foot, 1.0)]]]


def nine_curved(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a ring and a stem that bends to the left."""
    ring = _head(vary, pen)
    x, _ = ring[-1]
    return [[ring, [ring[-1], (x - vary(0.02, 0.015), 0.55), (vary(0.24, 0.05), 1.0)]]]


def nine_g_shaped(vary: Vary, pen: float) -> list[Stroke]:
    """Draw a slim ring and a stem that curls back below it like a g."""
    half = max(vary(0.125, 0.025), 0.5 * pen + 0.4 * CLEAR)
    deep = max(vary(0.20, 0.03), 0.5 * pen + 0.8 * CLEAR)
    middle, slant = vary(0.21, 0.035), vary(0.13, 0.10)
    ring = arc((middle, deep), (half, deep), vary(-35.0, 15.0), -325.0, 9)
    right, low = middle + half, vary(0.17, 0.03)
    belly = right + vary(0.08, 0.045)
    hook = arc((0.5 * belly, 1.0 - low), (0.5 * belly, low), 5.0, vary(142.0, 22.0), 6)
    start = (right + 0.5 * slant * deep, vary(0.11, 0.05))
    return [[lean(ring, slant, deep), [start, (right + 0.2 * (belly - right), 0.48), *hook]]]
