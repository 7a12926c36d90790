from __future__ import annotations

import json

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
