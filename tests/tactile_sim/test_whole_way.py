"""Data sets of touches: upload and download, galleries, and errors of the command line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
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


def _mesh(folder: Path, kind: str) -> Path:
    mesh = block().apply_scale(1000)
    if kind == "open":
        mesh.update_faces(np.arange(12) > 0)
    elif kind == "inside-out":
        mesh.invert()
    elif kind == "flat":
        mesh = trimesh.Trimesh([[0, 0, 0], [9, 0, 0], [0, 9, 0]], [[0, 1, 2], [0, 2, 1]], process=False)
    file = folder / f"{kind}.stl"
    mesh.export(file)
    return file


@pytest.mark.parametrize(
    ("mesh", "options", "message"),
    [
        ("open", (), "the surface is open"),
        ("inside-out", (), "inside-out"),
        ("flat", (), "bounds no solid"),
        ("block", ("--at-mm", "nan,0"), "x_m of a pose is nan"),
        ("block", ("--at-mm", "70,0"), "above the cell of 120 x 120 mm"),
        ("block", ("--at-mm", "1"), "expected x,y in millimetres"),
        ("block", ("--turn-deg", "inf"), "--turn-deg is inf"),
        *(
            ("block", ("--size", wrong), "expected WIDTHxHEIGHT in pixels")
            for wrong in ("wide", "80", "axb", f"9x{'9' * 5_000}")
        ),
        ("block", ("--size", "0x10"), "expected width and height in whole pixels"),
        ("block", ("--size", "9999x9999"), "at most 16,777,216 pixels"),
        ("block", ("--layer-mm", "5"), "layers are 0.005 m high"),
        ("block", ("--layer-mm", "thin"), "expected"),
        ("block", ("--sensor-noise", "calibrated"), "'depth' do not have the calibrated noise"),
        ("block", ("--weights", "none.npz"), "--weights has no effect without --optics cyclegan"),
        ("block", ("--out", "touch.tif"), "expected a name that ends with .png, .jpg, .jpeg"),
        ("none", (), "No such file"),
    ],
)
def test_invalid_renderings_are_refused_and_write_nothing(mesh, options, message, tmp_path):
    file = tmp_path / "none.stl" if mesh == "none" else _mesh(tmp_path, mesh)
    out = tmp_path / "touch.png"
    command = ["render", str(file), "--optics", "depth", "--out", str(out), *options]
    result = CliRunner().invoke(app, command, env={"COLUMNS": "300"})
    assert result.exit_code == 2, result.output
    text = result.output + (str(result.exception) if result.exception else "")
    assert message in text
    assert not out.exists()


def test_invalid_poses_are_refused():
    solid, flat = block(), np.diag([1.0, 1.0, 0.0, 1.0])
    broken = tactile_sim.pose()
    broken[0, 3] = np.nan
    for pose, message in (
        (broken, "NaN or infinite"),
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
