"""Specifications and placements of all kinds, for property-based tests."""

from __future__ import annotations

import math

from hypothesis import strategies as st

from starstruck_gen.placement import Placement
from starstruck_gen.shapes import OUTLINES, STAR, Shape
from starstruck_gen.spec import SceneSpec

names = st.sampled_from(sorted(OUTLINES))
radii_m = st.floats(0.002, 0.012)


@st.composite
def specs(draw, collision=("circles", "exact")):
    stars = draw(st.sets(st.integers(1, 4), min_size=1, max_size=3))
    least = draw(st.integers(0, 2))
    kinds = draw(st.lists(names.filter(lambda name: name != STAR), min_size=1, max_size=3))
    return SceneSpec(
        cell_m=(draw(st.floats(0.10, 0.30)), draw(st.floats(0.10, 0.30))),
        stars=tuple(sorted(stars)),
        distractors=(least, least + draw(st.integers(0, 2))),
        star=Shape(STAR, draw(radii_m)),
        distractor_shapes=tuple(Shape(name, draw(radii_m)) for name in kinds),
        heights_m=tuple(draw(st.lists(st.floats(0.001, 0.02), min_size=1, max_size=3))),
        rotation_rad=draw(st.sampled_from([0.0, 1.0, math.tau])),
        collision=draw(st.sampled_from(collision)),
        clearance_m=draw(st.sampled_from([0.0, 0.001])),
    )


@st.composite
def placements(draw):
    return Placement(
        draw(names),
        draw(st.floats(-0.9, 0.9)),
        draw(st.floats(-0.9, 0.9)),
        draw(st.floats(0, math.tau)),
        draw(radii_m),
        draw(st.floats(0.001, 0.02)),
    )
