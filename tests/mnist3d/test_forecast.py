"""Dry runs where another data set lies, values of other types, and folders whose run is not finished."""

from __future__ import annotations

import json
import shutil
import sys

import numpy as np
import pytest

from mnist3d.make import DigitMaking, GenerateSpec, generate
from mnist3d.solid import SolidSpec
from mnist3d.sources.synthetic import SyntheticSource
from mnist3d.splits import SplitSpec
from mnist3d.validate import validate_paths
from tactile_toolkit.errors import InputError, IntegrityError, SpecMismatchError
from tactile_toolkit.making import forecast
from tactile_toolkit.run import Part
from tests.sealed import sealed


def _spec(**values) -> GenerateSpec:
    split = SplitSpec(sizes={"train": np.int64(2), "test": 1})
    solid = SolidSpec(target_vertices=np.int64(2_000))
    return GenerateSpec(SyntheticSource(40), solid, split, **values)


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


def test_forecast_with_overwrite_tells_what_would_be_replaced(folder):
    other = _spec(limit=2)
    with pytest.raises(SpecMismatchError):
        forecast(DigitMaking(other), folder, ("train", "test"))
    before = (folder / "manifest.json").read_bytes()
    view = forecast(DigitMaking(other), folder, ("train", "test"), overwrite=True)
    assert view.replaced == {"train": 3, "test": 3}
    assert (view.rows_to_make, [entry["finished"] for entry in view.splits]) == (4, [0, 0])
    for mode in ({"part": Part(0, 2)}, {"finish": True}, {"finish": True, "check": True}):
        with pytest.raises(InputError, match="--overwrite was given with --part or --finish"):
            forecast(DigitMaking(other), folder, ("train", "test"), **mode, overwrite=True)
    checked = forecast(DigitMaking(other), folder, ("train", "test"), check=True, overwrite=True)
    assert (checked.replaced, checked.splits) == (view.replaced, view.splits)
    assert (folder / "manifest.json").read_bytes() == before


def test_what_is_finished_takes_no_time(folder):
    done = forecast(DigitMaking(_spec(limit=3)), folder, ("train", "test"))
    assert (done.rows_to_make, done.seconds) == (0, 0)
    assert forecast(DigitMaking(_spec(limit=3)), folder / "other", ("train", "test")).seconds > 0


def test_command_passes_overwrite_on(folder, capsys, monkeypatch):
    from cli.mnist3d import main

    words = ["generate", "--out", str(folder), "--digits", "40", "--seed", "5", "--per-class", "1"]
    monkeypatch.setattr(sys, "argv", ["mnist3d", *words, "--vertices", "2000", "--dry-run", "--overwrite"])
    with pytest.raises(SystemExit) as left:
        main()
    assert not left.value.code
    assert f"would replace the data set in {folder}: 6 rows (train 3, test 3)" in capsys.readouterr().out


def test_unfinished_folder_is_not_validated_as_if_it_were_whole(folder, tmp_path):
    part = tmp_path / "part"
    shutil.copytree(folder, part)
    manifest = json.loads((part / "manifest.json").read_text())
    kept = [entry for entry in manifest["shards"] if "test" in json.dumps(entry)]
    (part / "manifest.json").write_text(sealed(manifest | {"shards": kept, "complete": False}))
    with pytest.raises(IntegrityError, match="not finished"):
        validate_paths([str(part)])
    assert validate_paths([str(part)], "test")[0].checked == 3
