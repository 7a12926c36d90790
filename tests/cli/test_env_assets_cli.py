from __future__ import annotations

import json

import pytest

import mnist3d
from tests.command_line import run


def test_a_wrench_is_made_as_a_data_set_and_a_file(tmp_path):
    words = ("wrench", "--opening-mm", 16, "--second-opening-mm", 13, "--out", tmp_path / "wrench")
    made = run("env-assets", *words)
    assert made.exit_code == 0, made.output
    assert made.stdout.startswith("wrench for 16 and 13 mm across flats: ")
    assert run("tactile", "export", tmp_path / "wrench", "--out", tmp_path / "files").exit_code == 0
    (file,) = (tmp_path / "files").iterdir()
    assert mnist3d.inspect(mnist3d.read_mesh(file)).warnings == ()
    page = run("tactile", "gallery", tmp_path / "wrench", "--out", tmp_path / "page", "--workers", 1)
    assert page.exit_code == 0, page.output
    verified = run("tactile", "verify", tmp_path / "wrench", "--content")
    assert "1 row," in verified.stdout
    assert "1 of 1 wrenches are valid" in verified.stdout
    again = run("env-assets", *words, "--quiet")
    assert (again.exit_code, again.stdout) == (0, "")
    other = run("env-assets", "wrench", "--opening-mm", 14, "--out", tmp_path / "wrench")
    assert other.exit_code == 2
    assert "another specification" in other.stderr
    assert run("env-assets", "wrench", "--out", tmp_path / "wrench", "--overwrite").exit_code == 0


def test_every_length_reaches_the_wrench():
    lengths = {"opening_mm": 14.0, "second_opening_mm": 11.0, "clearance_mm": 0.1}
    options = (word for name, length in lengths.items() for word in (f"--{name.replace('_', '-')}", length))
    spec = json.loads(run("env-assets", "wrench", *options, "--dry-run", "--json").stdout)["spec"]
    assert {name: spec[name] for name in lengths} == lengths


@pytest.mark.thorough
def test_a_wrench_is_exported_for_printers_and_simulators(tmp_path):
    """By the export of all data sets of meshes; the mass in the simulator is that of the report."""
    words = ("--opening-mm", 10, "--second-opening-mm", 13, "--out", tmp_path / "wrench", "--json")
    made = run("env-assets", "wrench", *words)
    mass_kg = 1e-3 * json.loads(made.stdout)["mass_g"]
    for kind, file in (("stl", "stl"), ("mjcf", "xml"), ("urdf", "urdf")):
        done = run("tactile", "export", tmp_path / "wrench", "--format", kind, "--out", tmp_path / kind)
        assert done.exit_code == 0, done.output
        assert (tmp_path / kind / f"train-wrench-00000.{file}").is_file()
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "mjcf" / "train-wrench-00000.xml"))
    assert model.body_mass.sum() == pytest.approx(mass_kg, rel=1e-3)
    missing = run("tactile", "export", tmp_path / "nowhere", "--out", tmp_path / "none")
    assert missing.exit_code == 2
    assert not (tmp_path / "none").exists()
