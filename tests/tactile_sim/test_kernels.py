"""Steps of the Taxim kernels one by one; entire pictures need the extra `sim`."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from scipy.ndimage import binary_dilation, correlate1d

from tactile_sim.optics import taxim_kernels
from tests.tactile_sim import made_up_sensor
from tests.unchanged.record import numbers_of, recorded


@pytest.fixture(scope="module")
def in_python(tmp_path_factory):
    """A made-up sensor, and its pictures without compiled kernels."""
    package = tmp_path_factory.mktemp("made-up") / "taxim"
    made_up_sensor.write_calibration(package)
    command = [sys.executable, "-m", made_up_sensor.__name__, str(package)]
    made = subprocess.run(
        command, env={**os.environ, "NUMBA_DISABLE_JIT": "1"}, capture_output=True, check=True
    )
    return package, np.frombuffer(made.stdout, np.float32).reshape(3, 16, 20, 3)


@pytest.mark.thorough
def test_pictures_of_a_made_up_sensor_are_unchanged(in_python):
    expected = numbers_of(recorded()["made_up_sensor"])
    assert made_up_sensor.sums(in_python[1]) == pytest.approx(expected, abs=1e-4)


@pytest.mark.thorough
def test_compiled_kernels_give_the_bits_of_python(in_python):
    package, shades = in_python
    assert (made_up_sensor.pictures(package) == shades).all()


@pytest.mark.parametrize("step", [1, 3])
@pytest.mark.parametrize(("across", "down"), [([0.5, 0.3, -0.1], [0.7, 0.2]), ([1.0], [0.4, 0.3, 0.2, 0.1])])
@pytest.mark.parametrize("columns", [16, 21, 32])
def test_blur_is_that_of_scipy_with_the_edge_mirrored(across, down, columns, step):
    random = np.random.default_rng(0)
    image = random.random((5, columns, step))
    expected = image
    for axis, half in enumerate((down, across)):
        expected = correlate1d(expected, [*half[:0:-1], *half], axis, mode="mirror")
    flat, kept = image.reshape(5, -1), random.random((5, columns * step)) < 0.5
    taxim_kernels.blur(flat, np.array(across), np.array(down), step, kept, out := flat.copy())
    np.testing.assert_allclose(out, np.where(kept, flat, expected.reshape(flat.shape)), rtol=1e-12)


@pytest.mark.parametrize("windows", [[[2, 2], [3, 3]], [[1, 4], [5, 2]], [[1, 1], [1, 1]]])
def test_the_rim_is_where_two_windows_reach(windows):
    mask = np.random.default_rng(1).random((30, 40)) < 0.01
    near = mask
    for width, height in windows:
        # A window of even size is off-centre to the upper left, that of SciPy to the lower right.
        origin = [-((side + 1) % 2) for side in (height, width)]
        near = binary_dilation(near, np.ones((height, width)), origin=origin)
    assert (taxim_kernels._rim(mask, np.array(windows)) == near & ~mask).all()


def test_slopes_of_a_plane_and_of_a_level_surface():
    row, column = np.mgrid[:6.0, :9.0]
    slope, direction = taxim_kernels._slopes(0.3 * column - 0.2 * row, 0.5, 0.5, 1e-6)
    # Two pixels apart, and halved: the slope of the plane, up to where it rises.
    assert slope == pytest.approx(np.full((6, 9), np.arctan(np.hypot(0.3, 0.2))))
    assert direction == pytest.approx(np.full((6, 9), np.arctan2(0.2, -0.3) + np.pi))
    slope, direction = taxim_kernels._slopes(np.full((4, 5), 0.7), 0.5, 0.5, 1e-6)
    assert (slope == 0).all()
    assert (direction == np.pi).all()
    # Pixels at the edge copy their neighbours, for any surface.
    bumps = np.random.default_rng(0).random((5, 6))
    for table in taxim_kernels._slopes(bumps, 0.5, 0.5, 1e-6):
        assert (table == np.pad(table[1:-1, 1:-1], 1, mode="edge")).all()
