"""Dry runs into folders with another or an unfinished data set, and with values of other types."""

from __future__ import annotations

import json

import numpy as np
import pytest

from mnist3d.digit_generation import DigitGenerator, DigitSetSpec, generate
from mnist3d.digit_options import SolidSpec, SplitSpec
from mnist3d.sources.synthetic import SyntheticSource
from tactile_toolkit.errors import InputError, SpecMismatchError
from tactile_toolkit.run import Part


def _spec(**values) -> DigitSetSpec:
    split = SplitSpec(sizes={"train": np.int64(2), "test": 1})
    solid = SolidSpec(target_vertices=np.int64(2_000))
    return DigitSetSpec(SyntheticSource(40), solid, split, **values)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("digits") / "set"
    generate(_spec(limit=np.int64(3)), path)
    return path


def test_values_of_numpy_and_mappings_are_the_same_specification():
    assert SplitSpec(np.int64(3), sizes={"train": 2}) == SplitSpec(3, sizes=(("train", 2),))
    assert json.loads(json.dumps(_spec(per_class=np.int64(2)).to_dict()))["per_class"] == 2
    with pytest.raises(InputError, match=r"limit of .* is 2\.5"):
        _spec(limit=2.5)


def test_forecast_with_overwrite_names_what_would_be_replaced(folder):
    other = _spec(limit=2)
    with pytest.raises(SpecMismatchError):
        DigitGenerator(other).forecast(folder, ("train", "test"))
    before = (folder / "manifest.json").read_bytes()
    view = DigitGenerator(other).forecast(folder, ("train", "test"), overwrite=True)
    assert view.replaced == {"train": 3, "test": 3}
    assert (view.rows_to_make, [entry["finished"] for entry in view.splits]) == (4, [0, 0])
    for mode in ({"part": Part(0, 2)}, {"finish": True}, {"finish": True, "check": True}):
        with pytest.raises(InputError, match="overwrite was given with --part or --finish"):
            DigitGenerator(other).forecast(folder, ("train", "test"), **mode, overwrite=True)
    checked = DigitGenerator(other).forecast(folder, ("train", "test"), check=True, overwrite=True)
    assert (checked.replaced, checked.splits) == (view.replaced, view.splits)
    assert (folder / "manifest.json").read_bytes() == before
