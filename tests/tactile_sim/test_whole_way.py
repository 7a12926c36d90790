"""Data sets of touches: upload and download, galleries, and errors of the command line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import starstruck_gen
import tactile_sim
from cli import tactile
from cli.tactile_sim import app
from tactile_toolkit.errors import InputError
from tests.gallery_files import files_of
from tests.tactile_sim.solids import block

pytestmark = [
    pytest.mark.sim,
    pytest.mark.filterwarnings("ignore:Use 'content=<...>':DeprecationWarning"),  # made by the client
]

NAME = "someone/synthetic"


def _call(*arguments: object) -> str:
    result = CliRunner().invoke(tactile.app, [*map(str, arguments)])
    assert result.exit_code == 0, result.output
    return result.output


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """Touches of three scenes in two splits, as printed."""
    folder = tmp_path_factory.mktemp("way")
    scenes = starstruck_gen.SceneSetSpec(scenes=(("train", 3), ("test", 3)))
    starstruck_gen.generate(scenes, str(folder / "scenes"))
    plan = tactile_sim.TouchPlan(1, 4, "object", seed=2)
    spec = tactile_sim.TouchSetSpec((64, 48), "depth", plan=plan, layer_m=0.0002)
    tactile_sim.generate(str(folder / "scenes"), spec, folder / "touches")
    return folder / "touches"


def test_a_gallery_and_a_preview_show_every_round(made, tmp_path):
    _call("gallery", made, "--out", tmp_path / "site", "-w", 1, "--quiet")
    assert len(list((files_of(tmp_path / "site") / "items").iterdir())) == 6
    assert "Synthetic touches" in (tmp_path / "site" / "index.html").read_text()
    _call("preview", made, "--split", "test", "--out", tmp_path / "round.png", "--round", 1)
    assert (tmp_path / "round.png").stat().st_size > 1000


def test_invalid_poses_are_refused():
    solid, flat = block(), np.diag([1.0, 1.0, 0.0, 1.0])
    broken = tactile_sim.pose()
    broken[0, 3] = np.nan
    for pose, message in (
        (broken, "holds NaN, or a number beyond"),
        (flat, "not a rigid pose"),
        (np.eye(3), "expected a pose"),
        ("here", "expected a pose"),
    ):
        with pytest.raises(InputError, match=message):
            tactile_sim.render_touch(solid, pose, tactile_sim.pose())


def test_without_taxim_the_missing_extra_is_named(made, tmp_path, monkeypatch):
    import tactile_sim.optics.taxim
    import tactile_sim.sets.round_press

    tactile_sim.sets.round_press._optics.cache_clear()
    monkeypatch.setattr("tactile_sim.optics.taxim.find_spec", lambda _: None)
    tactile_sim.optics.taxim.taxim_package.cache_clear()
    result = CliRunner().invoke(
        app, ["generate", str(made.parent / "scenes"), "--optics", "taxim", "--out", str(tmp_path / "out")]
    )
    tactile_sim.optics.taxim.taxim_package.cache_clear()
    assert result.exit_code == 2
    assert "the extra `sim`" in result.output + str(result.exception)
    assert not (tmp_path / "out").exists()
