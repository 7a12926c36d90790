from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import pytest
import typer

from cli.digit_options import DivisionOptions, SolidOptions
from cli.env_assets import WrenchOptions
from cli.options import local_place
from cli.scene_options import SceneOptions
from cli.tactile_sim import PictureOptions, PlanOptions
from cli.tactile_sim_learning import TrainOptions
from env_assets.wrench.spec import WrenchSpec
from mnist3d.solid import SolidSpec
from mnist3d.splits import SplitSpec
from starstruck_gen.spec import SceneSpec
from tactile_sim import GenerateSpec, TouchPlan


def test_places_to_write_are_local_and_the_home_folder_is_known(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert local_place("~/pictures") == tmp_path / "pictures"
    assert local_place("a//b") == Path("a/b")
    assert local_place(Path("gallery")) == Path("gallery")
    for address in ("s3://bucket/site", "memory://site", "file:///tmp/site"):
        with pytest.raises(typer.BadParameter, match="is a remote address; expected a local path"):
            local_place(address)


def test_the_home_of_nobody_is_refused():
    with pytest.raises(typer.BadParameter, match="no home folder is known"):
        local_place("~nobody-of-that-name/x")


def test_options_that_are_not_given_mean_the_defaults_of_the_library():
    assert SolidOptions().spec() == SolidSpec()
    assert DivisionOptions().spec() == SplitSpec()
    assert SceneOptions().spec() == SceneSpec()
    assert WrenchOptions().spec() == WrenchSpec.for_size()
    assert PlanOptions().plan() == TouchPlan()
    assert PictureOptions().spec() == GenerateSpec()


@pytest.mark.torch
def test_a_training_that_nothing_is_said_of_is_that_of_the_library():
    pytest.importorskip("torch", reason="needs torch, of the extra torch")
    from tactile_sim.learned.config import TrainConfig

    assert TrainConfig(**{**asdict(TrainOptions()), "sensor_noise": None}) == TrainConfig()
