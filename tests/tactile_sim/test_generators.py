"""Inference with generators: the values of their layers, single or in batches, with any number of threads."""

from __future__ import annotations

import copy
import dataclasses
import pickle

import numpy as np
import pytest

from tactile_toolkit.errors import InputError
from tactile_toolkit.store import open_folder

pytestmark = [pytest.mark.torch]
torch = pytest.importorskip("torch", reason="needs torch, of the extra torch")

from tactile_sim.learned import DepthEstimator  # noqa: E402
from tactile_sim.learned.generators import FastGenerator, make_generator  # noqa: E402
from tactile_sim.learned.networks import GeneratorNetwork, initialise  # noqa: E402
from tactile_sim.learned.weights import generator_of, weights_of, write_weights  # noqa: E402
from tactile_sim.optics import make_optics  # noqa: E402

SIZES = {"whole tiles": (32, 16), "parts of tiles": (40, 28), "one tile": (16, 16)}


def _weights(size_px=(40, 28), filters=4, blocks=2):
    network = GeneratorNetwork(filters, blocks)
    initialise(network, 3)
    return weights_of(network, size_px)


def _images(count, size_px=(40, 28)):
    width, height = size_px
    return torch.rand(count, 3, height, width, generator=torch.Generator().manual_seed(1)) * 2 - 1


@pytest.fixture
def threads():
    """Sets the number of threads, which is restored."""
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


@pytest.mark.parametrize("filters", [4, 20])  # 80 channels are more than one block of them
@pytest.mark.parametrize("size_px", SIZES.values(), ids=SIZES)
@pytest.mark.parametrize("has_library", [True, False])
def test_values_are_those_of_the_layers(size_px, filters, has_library, monkeypatch):
    monkeypatch.setattr(torch.backends.mkldnn, "is_available", lambda: has_library)
    weights, images = _weights(size_px, filters), _images(2, size_px)
    with torch.inference_mode():
        exact = generator_of(weights).double()(images.double())
    found = FastGenerator(dataclasses.replace(weights, size_px=(24, 20)))(images)  # images of any size
    assert (found.dtype, found.shape) == (torch.float32, images.shape)
    assert (found - exact).abs().max() < 2e-5  # 0.003 of 255 levels


def test_an_image_depends_neither_on_its_batch_nor_on_threads(threads):
    generator, images = FastGenerator(_weights()), _images(5)
    threads(1)
    expected = generator(images)
    for count in (1, 2, 3, 8):
        threads(count)
        assert torch.equal(generator(images), expected), count
        assert torch.equal(torch.cat([generator(each[None]) for each in images]), expected), count
        assert torch.get_num_threads() == count


def test_generators_can_be_copied():
    """Environments are copied, and sent to other processes."""
    images = _images(1)
    for generator in (FastGenerator(_weights()), make_generator(_weights())):
        for copied in (copy.deepcopy(generator), pickle.loads(pickle.dumps(generator))):
            assert torch.equal(copied(images), generator(images))


def test_large_generators_are_fast_ones():
    assert isinstance(make_generator(_weights((256, 256), 16, 1)), FastGenerator)
    assert not isinstance(make_generator(_weights((64, 64), 16, 1)), FastGenerator)


@pytest.mark.skipif(not torch.cpu._is_avx512_bf16_supported(), reason="the processor has no bfloat16")
@pytest.mark.parametrize("size_px", [(64, 64), (256, 256)])
def test_bfloat16_is_close(size_px):
    weights, images = _weights(size_px, 16, 1), _images(1, size_px)
    off = (make_generator(weights, bfloat16=True)(images) - make_generator(weights)(images)).abs()
    assert 0 < off.mean() < 0.03


def test_missing_hardware_is_named(monkeypatch, tmp_path):
    write_weights(open_folder(str(tmp_path)), "small.npz", _weights())
    monkeypatch.setattr(torch.cpu, "_is_avx512_bf16_supported", lambda: False)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    for make in (DepthEstimator, lambda *given, **options: make_optics("cyclegan", *given, **options)):
        with pytest.raises(InputError, match="bfloat16 was asked for, but this processor"):
            make(tmp_path / "small.npz", bfloat16=True)
        with pytest.raises(InputError, match="device is 'cuda', but PyTorch finds no GPU"):
            make(tmp_path / "small.npz", device="cuda")
        with pytest.raises(InputError, match="device is 'gpu'; expected auto, cpu or cuda"):
            make(tmp_path / "small.npz", device="gpu")


def test_estimates_need_images(tmp_path):
    write_weights(open_folder(str(tmp_path)), "small.npz", _weights())
    estimator = DepthEstimator(tmp_path / "small.npz")
    touches = np.random.default_rng(0).integers(0, 256, (3, 30, 40, 3), np.uint8)
    depth_m = estimator.estimate_m(touches, (20, 10))
    assert (depth_m.shape, depth_m.dtype) == ((3, 10, 20), np.float32)
    assert 0.002125 <= depth_m.min() < depth_m.max() <= np.float32(0.00425)
    assert (estimator.estimate_m(touches[1:2], (20, 10))[0] == depth_m[1]).all()
    for wrong in (touches[0], touches[..., :2], touches.astype(np.float32), touches[:0]):
        with pytest.raises(InputError, match="expected uint8"):
            estimator.estimate_m(wrong, (20, 10))
    with pytest.raises(InputError, match="size of the image"):
        estimator.estimate_m(touches, (0, 10))
