"""Specifications and placements of all kinds, for property-based tests."""

from __future__ import annotations

import math

from hypothesis import strategies as st

from starstruck_gen.sampling import SceneSpec
from starstruck_gen.scene import Placement
from starstruck_gen.shapes import KINDS, STAR, Crescent, Cross, Disc, Ring, Shape, Star

names = st.sampled_from(sorted(KINDS))
radii_m = st.floats(0.002, 0.012)
segments = st.integers(8, 256)


@st.composite
def stars(draw):
    points = draw(st.integers(3, 64))
    return Star(points, draw(st.floats(0.05, min(0.95, 0.99 * math.cos(math.pi / points)))))


DRAWN = {
    STAR: stars(),
    "disc": st.builds(Disc, segments),
    "ring": st.builds(Ring, st.floats(0.05, 0.95), segments),
    "cross": st.builds(Cross, st.floats(0.05, 0.65)),
    "crescent": st.builds(Crescent, st.floats(0.25, 1.5), st.floats(0.2, 0.9), segments),
}


@st.composite
def shapes(draw, names=names):
    name = draw(names)
    if name not in DRAWN or draw(st.booleans()):
        return Shape(name, draw(radii_m))
    return Shape(name, draw(radii_m), draw(DRAWN[name]))


@st.composite
def specs(draw, collision=("circles", "exact")):
    counts = draw(st.sets(st.integers(1, 4), min_size=1, max_size=3))
    least = draw(st.integers(0, 2))
    others = names.filter(lambda name: name != STAR)
    return SceneSpec(
        cell_m=(draw(st.floats(0.10, 0.30)), draw(st.floats(0.10, 0.30))),
        stars=tuple(sorted(counts)),
        distractors=(least, least + draw(st.integers(0, 2))),
        star=draw(shapes(st.just(STAR))),
        distractor_shapes=tuple(draw(st.lists(shapes(others), min_size=1, max_size=3))),
        heights_m=tuple(draw(st.lists(st.floats(0.001, 0.02), min_size=1, max_size=3))),
        rotation_rad=draw(st.sampled_from([0.0, 1.0, math.tau])),
        collision=draw(st.sampled_from(collision)),
        clearance_m=draw(st.sampled_from([0.0, 0.001])),
    )


@st.composite
def placements(draw):
    return Placement(
        draw(shapes()).key,
        draw(st.floats(-0.9, 0.9)),
        draw(st.floats(-0.9, 0.9)),
        draw(st.floats(0, math.tau)),
        draw(radii_m),
        draw(st.floats(0.001, 0.02)),
    )
