"""Each published step of the solid on its own."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp
from scipy import ndimage

from mnist3d.compiled_loops import signed_distance_px
from mnist3d.digit_options import SolidSpec
from mnist3d.ink.binarisation import binarise
from mnist3d.solid.algorithm import (
    Surface,
    decimate,
    erode,
    eroded_by_disc,
    erosion_radii_px,
    isosurface,
    smooth,
    solidify,
)
from mnist3d.solid.lattice import lattice_of
from tactile_toolkit.mesh import Mesh, PrintReport
from tests.mnist3d.drawings import six


@given(
    hnp.arrays(bool, st.tuples(st.integers(1, 40), st.integers(1, 40))), st.floats(1, 24), st.floats(1, 24)
)
def test_distance_is_exact_up_to_its_reaches(mask: np.ndarray, inside: float, outside: float) -> None:
    # There is neither ink nor paper outside of the image.
    reach = math.ceil(max(inside, outside)) + 1
    none = [np.full(np.add(mask.shape, 2 * reach), fill) for fill in (True, False)]
    for there in none:
        there[reach:-reach, reach:-reach] = mask
    ink, paper = none[0], ~none[1]
    window = (slice(reach, -reach),) * 2
    to_paper, to_ink = (ndimage.distance_transform_edt(where)[window] for where in (ink, paper))
    expected = np.where(mask, np.minimum(to_paper - 0.5, inside), -np.minimum(to_ink - 0.5, outside))
    assert np.allclose(signed_distance_px(mask, inside, outside), expected, atol=1e-5)


@given(hnp.arrays(bool, st.tuples(st.integers(3, 25), st.integers(3, 25))), st.floats(0, 8))
def test_erosion_is_binary_erosion_with_a_disc(mask: np.ndarray, radius: float) -> None:
    reach = math.ceil(radius) + 1
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    squared = y * y + x * x
    if np.isclose(np.sqrt(squared), radius + 0.5, atol=1e-5).any():
        return
    expected = ndimage.binary_erosion(mask, squared < (radius + 0.5) ** 2)
    assert np.array_equal(eroded_by_disc(mask, radius), expected)


def test_the_other_erosion_keeps_ink_farther_than_the_radius_from_paper() -> None:
    mask = binarise(six(), SolidSpec())
    distance = ndimage.distance_transform_edt(mask)
    printed = erosion_radii_px(SolidSpec())
    for radius, published in zip(erosion_radii_px(SolidSpec(erosion="disc")), printed, strict=True):
        assert np.array_equal(eroded_by_disc(mask, radius), distance > published)


def test_the_continuous_erosion_equals_the_published_one() -> None:
    """With every pixel as a node, apart from the blur and the small outward shift of the surface."""
    spec = SolidSpec(lattice_pitch_mm=0.2)
    ink = binarise(six(), spec)
    fine = lattice_of(ink, spec)
    assert fine.s_px.shape == (fine.ink.shape[0] - 1, fine.ink.shape[1] - 1)
    for height, radius in zip(np.arange(20) + 0.5, erosion_radii_px(spec), strict=True):
        left = erode(fine, np.array([height], np.float32), spec) > 0
        printed = eroded_by_disc(fine.ink, radius)[:-1, :-1]
        assert (left != printed).sum() <= 0.02 * fine.ink.sum()


def test_erosion_radii_of_the_other_profiles() -> None:
    assert np.array_equal(erosion_radii_px(SolidSpec(profile="linear")), np.arange(20) + 0.5)
    assert np.array_equal(erosion_radii_px(SolidSpec(profile="flat")), np.zeros(20))


def test_smoothing_evens_out_and_keeps_the_volume() -> None:
    grid = np.mgrid[-12:13, -12:13, -12:13]
    vertices, faces = isosurface((np.sqrt((grid**2).sum(axis=0)) < 9.3).astype(float), 0.5)
    smoothed = smooth(Surface(vertices, faces), 20, 0.5).vertices_px
    radii = [np.linalg.norm(v - 12, axis=1) for v in (vertices, smoothed)]
    assert radii[1].std() < 0.5 * radii[0].std()
    assert Mesh(smoothed, faces).volume_m3 == pytest.approx(Mesh(vertices, faces).volume_m3, rel=0.01)


def test_decimation_keeps_to_the_budget_and_to_the_solid() -> None:
    spec = SolidSpec()
    fine = solidify(six(), spec)
    coarse = decimate(fine, 3000)
    report = PrintReport.of(coarse)
    assert 1500 < len(coarse.vertices_m) <= 1.5 * 3000
    assert (report.is_solid, report.bodies, report.genus) == (True, 1, 1)
    assert coarse.volume_m3 == pytest.approx(fine.volume_m3, rel=0.03)
    assert decimate(coarse, 5000) is coarse
