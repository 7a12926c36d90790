"""The optics `cyclegan`: the published networks in both directions, and weights of other shapes."""

from __future__ import annotations

import warnings
import zipfile

import numpy as np
import pytest

import tactile_sim
from tests.tactile_sim.solids import ball, block

pytestmark = [pytest.mark.torch, pytest.mark.sim, pytest.mark.oracle]
torch = pytest.importorskip("torch", reason="needs torch, of the extra torch")
pytest.importorskip("tactile_mnist", reason="needs tactile-mnist, of the extra oracle")

from tactile_sim.learned import DepthEstimator, generators as files  # noqa: E402
from tactile_sim.learned.generators import (  # noqa: E402
    CycleganOptics,
    GeneratorNetwork,
    generator_of,
    initialise,
    weights_of,
)
from tactile_sim.optics.rendering import make_optics  # noqa: E402
from tactile_sim.sets.round_press import optics_of  # noqa: E402
from tactile_toolkit.errors import InputError, ToolkitError  # noqa: E402
from tactile_toolkit.store import open_folder  # noqa: E402


def _depths(size):
    sensor = tactile_sim.center_view(*size)
    targets = np.stack([tactile_sim.pose(*place) for place in ((0, 0), (0.004, 0.001), (0.04, 0))])
    solids = [ball(0.006), block(), block()]
    return sensor, tactile_sim.render_touch(solids, tactile_sim.pose(turn_rad=0.3), targets, sensor).depth_m


@pytest.fixture(scope="module")
def package():
    """The package's renderer and estimator, on PyTorch and the CPU."""
    from tests.published_envs import published_package

    cpu = published_package("tactile_mnist.tactile_renderer").Device("cpu")
    renderer = published_package("tactile_mnist.tactile_renderer.cycle_gan_renderer_torch")
    estimator = published_package("tactile_mnist.depth_estimator.cycle_gan_depth_estimator_torch")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # torch.jit.script is deprecated
        return renderer.CycleGANRendererTorch(cpu), estimator.CycleGANDepthEstimatorTorch(cpu)


@pytest.fixture
def small(tmp_path):
    """A file of small weights, drawn at random, for 32 x 24 pixels."""

    def made(name="small.npz", size_px=(32, 24), filters=4, blocks=2, seed=5):
        network = GeneratorNetwork(filters, blocks)
        initialise(network, seed)
        files.write_weights(open_folder(str(tmp_path)), name, weights_of(network, size_px))
        return tmp_path / name

    return made


def test_pictures_are_those_of_the_package_in_both_directions(package):
    renderer, estimator = package
    optics, inverse = make_optics("cyclegan"), DepthEstimator()
    assert optics.depth_size(64, 64) == renderer.get_desired_depth_map_size((64, 64)) == (256, 256)
    sensor, depths = _depths((128, 128))  # the networks take any size, and a small one costs less
    for size in ((128, 128), (64, 64)):
        expected = renderer.render(depths, size).clip(0, 1)
        assert np.abs(optics.shades(depths, sensor, size) - expected).max() < 1e-4
        pictures = optics.render(depths, sensor, size)
        assert np.abs(pictures - 255 * expected).max() <= 0.5 + 255e-4
    assert optics.shades(depths[:0], sensor, size).shape == (0, *size, 3)
    large = optics.render(depths[:1], sensor, (256, 256))
    assert inverse.input_size_px == estimator.input_size
    for touches, size in ((large, (256, 256)), (large, (48, 36)), (pictures[:1], (128, 128))):
        found = inverse.estimate_m(touches, size)
        assert (found.dtype, found.shape) == (np.float32, (len(touches), *size[::-1]))
        assert np.abs(found - estimator.estimate(touches, size)).max() < 1e-7  # a tenth of a micrometre
    assert pictures[2].std() > 0  # a bare plate counts as no contact


def test_a_picture_does_not_depend_on_its_batch_nor_on_threads(small):
    optics = CycleganOptics(small())
    sensor, depths = _depths(optics.depth_size(64, 64))
    together = optics.render(depths, sensor, (40, 30))
    alone = [optics.render(depths[[i]], sensor, (40, 30))[0] for i in range(len(depths))]
    assert (together == np.stack(alone)).all()
    assert together.shape == (3, 30, 40, 3)
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(threads + 1)
        assert (optics.render(depths, sensor, (40, 30)) == together).all()
    finally:
        torch.set_num_threads(threads)


def test_retrained_weights_are_read_again(small):
    """In one process: the manifest has the checksum of the file, so pictures must be made with this file."""
    spec = tactile_sim.TouchSetSpec((32, 24), "cyclegan", weights=str(small()))
    sensor, depths = _depths((32, 24))
    before = optics_of(spec)
    assert optics_of(spec) is before
    small(seed=6)
    found = optics_of(spec).render(depths, sensor, (32, 24))
    assert (found == CycleganOptics(spec.weights).render(depths, sensor, (32, 24))).all()
    assert (found != before.render(depths, sensor, (32, 24))).any()


def test_weights_survive_the_file_and_are_the_same_bytes(small):
    first, second = small("a.npz"), small("b.npz")
    assert first.read_bytes() == second.read_bytes()
    read = files.read_weights(first)
    assert (read.size_px, read.filters, read.blocks) == ((32, 24), 4, 2)
    assert files.weights_bytes(read) == first.read_bytes()
    with np.load(first) as stored:  # the reader of others
        assert set(stored.files) == set(GeneratorNetwork(4, 2).state_dict())
    network = generator_of(read)
    assert weights_of(network, (32, 24)).arrays.keys() == read.arrays.keys()
    published = files.read_weights(files.published_weights("touch"))
    assert (published.filters, published.blocks, published.size_px) == (64, 9, (256, 256))


def test_our_weights_run_in_the_package(small):
    """The package has nine blocks; its JAX version accepts any number of filters."""
    from tests.published_envs import published_package

    file = small(size_px=(256, 256), blocks=9)
    jax = published_package("tactile_mnist.tactile_renderer.cycle_gan_jax")
    pictures = np.random.default_rng(0).uniform(-1, 1, (1, 3, 16, 16)).astype(np.float32)
    theirs = np.asarray(jax.apply_generator_jax(jax.load_generator_params_jax(file), pictures))
    with torch.inference_mode():
        ours = generator_of(files.read_weights(file))(torch.from_numpy(pictures)).numpy()
    assert np.abs(theirs - ours).max() < 1e-5


def test_files_that_are_no_weights_are_named(small, tmp_path, monkeypatch):
    good = small()
    with pytest.raises(InputError, match="a picture of 64 x 15 pixels is too small; expected at least 16 x"):
        make_optics("cyclegan", good).depth_size(64, 15)
    for name, content in {"absent": None, "text": b"no archive", "cut": good.read_bytes()[:-400]}.items():
        if content is not None:
            (tmp_path / f"{name}.npz").write_bytes(content)
        with pytest.raises(InputError, match="cannot be read as weights"):
            make_optics("cyclegan", tmp_path / f"{name}.npz")
    arrays = dict(np.load(good))
    for content, text in (
        ({k: v for k, v in arrays.items() if "model.12" not in k}, "model.12"),
        ({**arrays, "model.4.bias": np.zeros(7, np.float32)}, "model.4.bias"),
        ({**arrays, "more": np.zeros(7, np.float32)}, "more"),
        ({**arrays, "model.4.bias": np.full(8, np.nan, np.float32)}, "model.4.bias"),
        ({"pictures": np.zeros(3)}, "pictures"),
        ({**arrays, "model.4.bias": np.array([{}])}, "pickle"),
    ):
        np.savez(tmp_path / "wrong.npz", **content)
        with pytest.raises(InputError, match=text):
            files.read_weights(tmp_path / "wrong.npz")
    for comment, text in (
        (b'{"size_px": [30, 1000000]}', "of 30 x 1000000 pixels; expected multiples of 4"),
        (b'{"size_px": [true, 32]}', "of True x 32 pixels"),
        (b'{"size_px": 32}', "cannot be read as weights"),
        (b"made by somebody", "cannot be read as weights"),
        (b"[" * 60_000, "cannot be read as weights"),
    ):
        with zipfile.ZipFile(good, "a") as archive:
            archive.comment = comment
        with pytest.raises(InputError, match=text):
            files.read_weights(good)
    monkeypatch.setattr(files, "find_spec", lambda _: None)
    with pytest.raises(InputError, match="next: give `weights`, or run `pip install --no-deps tactile-mnist"):
        make_optics("cyclegan")


def test_any_damage_is_a_named_error(small, tmp_path):
    """Or it is in bytes that mean nothing: the weights are the same."""
    good = small()
    content, expected = bytearray(good.read_bytes()), files.read_weights(good).arrays
    rng = np.random.default_rng(3)
    refused = 0
    for number in range(60):
        damaged = content.copy()
        for _ in range(3):
            damaged[rng.integers(len(damaged))] = rng.integers(256)
        file = tmp_path / f"{number}.npz"
        file.write_bytes(damaged)
        try:
            found = files.read_weights(file).arrays
        except ToolkitError:
            refused += 1
            continue
        assert found.keys() == expected.keys()
        assert all((found[name] == array).all() for name, array in expected.items())
    assert refused > 30
