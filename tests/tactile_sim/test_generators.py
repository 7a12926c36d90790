"""Inference with generators: images do not depend on their batch, and missing hardware is named."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

from tactile_toolkit.errors import InputError
from tactile_toolkit.store import open_folder

pytestmark = [pytest.mark.torch]
torch = pytest.importorskip("torch", reason="needs torch, of the extra torch")

from tactile_sim.learned import DepthEstimator  # noqa: E402
from tactile_sim.learned.generators import (  # noqa: E402
    GeneratorNetwork,
    initialise,
    make_generator,
    weights_of,
    write_weights,
)
from tactile_sim.optics.rendering import make_optics  # noqa: E402


def _weights(size_px=(40, 28), filters=4, blocks=2):
    network = GeneratorNetwork(filters, blocks)
    initialise(network, 3)
    return weights_of(network, size_px)


def _images(count, size_px=(40, 28)):
    width, height = size_px
    return torch.rand(count, 3, height, width, generator=torch.Generator().manual_seed(1)) * 2 - 1


def test_an_image_does_not_depend_on_its_batch():
    generator, images = make_generator(_weights()), _images(5)
    together = generator(images)
    assert (together.dtype, together.shape) == (torch.float32, images.shape)
    assert torch.equal(torch.cat([generator(each[None]) for each in images]), together)


def test_generators_can_be_copied():
    """Environments are copied, and sent to other processes."""
    generator, images = make_generator(_weights()), _images(1)
    for copied in (copy.deepcopy(generator), pickle.loads(pickle.dumps(generator))):
        assert torch.equal(copied(images), generator(images))


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
        with pytest.raises(InputError, match="expected an array of uint8"):
            estimator.estimate_m(wrong, (20, 10))
    with pytest.raises(InputError, match="size_px is"):
        estimator.estimate_m(touches, (0, 10))
