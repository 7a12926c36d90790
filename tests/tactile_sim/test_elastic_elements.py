"""The elastic gel and finite elements of the layer, under patches of digits: without friction, and stuck."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse.linalg import splu

import mnist3d
import tactile_sim
from mnist3d.sources.synthetic import SyntheticSource

skfem = pytest.importorskip("skfem", reason="needs the package scikit-fem")

pytestmark = pytest.mark.thorough

E_PA, POISSON, LAYER_M, PIXEL_M, COUNT = 0.2e6, 0.49, 4.25e-3, 3e-4, 21
DEPTH_M = 4e-4
# Digit, and where the sensor comes down on it.
PATCHES = ((1234, -0.016, -0.006), (520, -0.007, 0.026), (300, 0.001, 0.022))


def patch_compliance():
    """Return displacements along x, y, z of the points of a patch by a force on each, (3, n, 3, n), m / N.

    Quadratic hexahedra with a point at the centre of each pixel, and larger ones outwards; the base is fixed,
    the sides, 2 layers away, are free.
    """
    from skfem.models.elasticity import lame_parameters, linear_elasticity

    half_m = (COUNT - 1) / 2 * PIXEL_M
    inner = np.linspace(-half_m, half_m, COUNT // 2 + 1)
    outer = half_m + LAYER_M * np.array([0.25, 0.8, 2.0])
    x = np.concatenate([-outer[::-1], inner, outer])
    z = LAYER_M * np.array([0.0, 0.08, 0.25, 0.55, 1.0])
    basis = skfem.Basis(
        skfem.MeshHex.init_tensor(x, x, z), skfem.ElementVector(skfem.ElementHex2()), intorder=4
    )
    matrix = linear_elasticity(*lame_parameters(E_PA, POISSON)).assemble(basis)
    at_x, at_y, at_z = basis.doflocs
    moves = np.flatnonzero(at_z < LAYER_M - 1e-9)
    inside = (np.abs(at_x) < half_m + 1e-9) & (np.abs(at_y) < half_m + 1e-9)
    patch = np.flatnonzero(inside & (at_z < 1e-9))
    # By row of the image, then column; the three components of a point follow one another.
    patch = patch[np.lexsort((patch, at_x[patch].round(9), -at_y[patch].round(9)))].reshape(-1, 3)
    factors = splu(
        matrix[moves][:, moves].tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}
    )
    number = np.full(matrix.shape[0], -1)
    number[moves] = np.arange(len(moves))
    forced = number[patch.T.ravel()]
    loads = np.zeros((len(moves), len(forced)))
    loads[forced, np.arange(len(forced))] = 1.0
    found = factors.solve(loads)[forced]
    return found.reshape(3, COUNT**2, 3, COUNT**2)


@pytest.fixture(scope="module")
def compliance():
    return patch_compliance()


def patch_heights(digit, *at_m):
    """Return the heights of a digit under a patch, metres."""
    solid = tactile_sim.Pressable.of(mnist3d.solidify(SyntheticSource(seed=1).image(digit).pixels))
    sensor = tactile_sim.Sensor((COUNT, COUNT), (COUNT * PIXEL_M, COUNT * PIXEL_M))
    lies = tactile_sim.pose(z_m=-solid.foot_m)
    return -tactile_sim.render_touch(solid, lies, tactile_sim.pose(*at_m), sensor).depth_m


def elements(compliance, target_m, is_stuck):
    """Return force and displacement along z: contact by an active set, as each point pushes or is free."""
    count = len(target_m)
    axes = (0, 1, 2) if is_stuck else (2,)
    pushed = target_m > 0
    for _ in range(60):
        points = np.flatnonzero(pushed)
        square = compliance[np.ix_(axes, points, axes, points)].reshape(len(axes) * len(points), -1)
        wanted = np.zeros((len(axes), len(points)))
        wanted[-1] = target_m[points]
        forces = np.zeros((3, count))
        forces[np.ix_(axes, points)] = np.linalg.solve(square, wanted.ravel()).reshape(len(axes), -1)
        sunk = np.einsum("njc,jc->n", compliance[2].reshape(count, 3, count), forces)
        pulls, touches = forces[2] < 0, ~pushed & (sunk < target_m - 1e-9)
        if not (pulls | touches).any():
            return forces[2].sum(), sunk
        pushed = (pushed & ~pulls) | touches
    raise AssertionError("the active set does not settle")


@pytest.mark.parametrize("friction", [0.0, 1000.0], ids=["free", "stuck"])
@pytest.mark.parametrize("patch", PATCHES, ids=lambda patch: str(patch[0]))
def test_finite_elements_give_the_same_force_and_surface(patch, friction, compliance):
    heights_m = patch_heights(*patch)
    gel = tactile_sim.Gel(E_PA, POISSON, friction)
    contact = tactile_sim.solve_contact(heights_m, PIXEL_M, gel, thickness_m=LAYER_M, depth_m=DEPTH_M)
    target_m = DEPTH_M - (heights_m.max() - heights_m).ravel()
    force_n, sunk_m = elements(compliance, target_m, friction > 0)
    assert 0.15 < contact.is_contact.mean() < 0.7
    assert contact.force_n[2] == pytest.approx(force_n, rel=0.03)
    assert np.abs(contact.displacement_m[..., 2].ravel() - sunk_m).max() < 20e-6
