"""Digits of the synthetic source can be recognised, and train classifiers: small samples of the benchmark."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from mnist3d.sources.synthetic import SyntheticSource
from tests.real_input import NO_REAL_INPUT, SHARED

ROOT = Path(__file__).resolve().parents[2]
TRAIN_COUNT = 1_940
"""Balanced over writers and classes; the benchmark has the full sizes."""


@pytest.fixture(scope="module")
def recognition() -> Iterator[ModuleType]:
    spec = importlib.util.spec_from_file_location("recognition", ROOT / "benchmarks" / "recognition.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["recognition"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["recognition"]


@pytest.fixture(scope="module")
def synthetic(recognition: ModuleType) -> object:
    source = SyntheticSource()
    return recognition.synthetic_images(source, recognition.evenly(source.count, TRAIN_COUNT, 0.5))


@pytest.fixture(scope="module")
def mnist(recognition: ModuleType) -> object:
    if not SHARED.is_dir():
        pytest.skip(NO_REAL_INPUT)
    return recognition.load_mnist(SHARED / "mnist")


@pytest.fixture(scope="module")
def digits(recognition: ModuleType) -> object:
    if not SHARED.is_dir():
        pytest.skip(NO_REAL_INPUT)
    return recognition.load_digits(SHARED / "digits")


@pytest.mark.thorough
@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("count", [200, TRAIN_COUNT // 2])
def test_mnist_reads_synthetic_digits(recognition: ModuleType, mnist: object, count: int) -> None:
    source = SyntheticSource()
    images = recognition.synthetic_images(source, recognition.evenly(source.count, count, 0.5))
    reading = recognition.read("a", mnist, images)
    assert reading.accuracy > 0.92
    assert min(reading.per_class) > 0.83


@pytest.mark.thorough
def test_synthetic_digits_teach_to_read_real_ones(recognition, digits, synthetic):
    assert recognition.read("b", synthetic, digits).accuracy > 0.85


def test_normalised_images_are_centred_boxes(recognition: ModuleType) -> None:
    page = np.full((500, 500), 255, dtype=np.uint8)
    page[100:400, 30:130] = 0
    page[2:5, 490:495] = 0
    frame = recognition.normalise(page)
    assert np.flatnonzero(frame.any(axis=1)).tolist() == list(range(4, 24))
    assert frame.any(axis=0).sum() == 7
    assert frame.max() == 255.0
