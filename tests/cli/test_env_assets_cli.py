from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

import mnist3d
import starstruck_gen
from cli.env_assets import app
from tests.command_line import alone


def run(*words):
    with alone():
        return CliRunner().invoke(app, list(map(str, words)))


def test_a_wrench_is_made_as_data_set_and_file(tmp_path):
    made = run("wrench", "--size", "M10", "--out", tmp_path / "wrench", "--stl", tmp_path / "wrench.stl")
    assert made.exit_code == 0, made.output
    assert made.stdout.startswith("wrench for 16 and 13 mm across flats: ")
    assert mnist3d.inspect(mnist3d.read_mesh(tmp_path / "wrench.stl")).warnings == ()
    verified = run("verify", tmp_path / "wrench")
    assert "1 row," in verified.stdout
    again = run("wrench", "--size", "M10", "--out", tmp_path / "wrench", "--quiet")
    assert (again.exit_code, again.stdout) == (0, "")
    other = run("wrench", "--size", "13", "--out", tmp_path / "wrench")
    assert other.exit_code == 2
    assert "another specification" in other.stderr
    assert run("wrench", "--out", tmp_path / "wrench", "--overwrite").exit_code == 0


def test_every_length_reaches_the_wrench():
    made = run(
        *("wrench", "--size", "M8", "--second-size", 11, "--length-mm", 140, "--thickness-mm", 7),
        *("--handle-mm", 9, "--jaw-angle-deg", 30, "--clearance-mm", 0.1, "--chamfer-mm", 0.4),
        *("--dry-run", "--json"),
    )
    expected = {
        "opening_mm": 13.0,
        "second_opening_mm": 11.0,
        "length_mm": 140.0,
        "thickness_mm": 7.0,
        "handle_mm": 9.0,
        "jaw_angle_deg": 30.0,
        "clearance_mm": 0.1,
        "chamfer_mm": 0.4,
    }
    spec = json.loads(made.stdout)["spec"]
    assert {name: spec[name] for name in expected} == expected
    single = run("wrench", "--single", "--dry-run")
    assert single.stdout.startswith("wrench for 13 mm across flats: ")
    assert "warning: larger-than-plate\n" in run("wrench", "--length-mm", 400, "--dry-run").stdout


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--size", "M7"), "no wrench of size 'M7' is made"),
        (("--chamfer-mm", "3"), "--chamfer-mm of the wrench is 3"),
        (("--single", "--second-size", "10"), "a wrench with a single jaw"),
        (("--stl", "wrench.step"), "files ending in '.step' are not known"),
        (("--stl", "wrench.step", "--dry-run"), "files ending in '.step' are not known"),
        (("--stl", "nowhere/wrench.stl"), "cannot write 'nowhere/wrench.stl': No such file or directory"),
        (("--stl", f"{__file__}/wrench.stl"), "Not a directory"),
        (("--handle-mm", "1.9"), "--handle-mm of the wrench is 1.9; expected more than 2.4"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    failed = run("wrench", *words)
    assert failed.exit_code == 2
    assert message in failed.stderr
    assert failed.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.thorough
def test_the_home_of_the_user_is_known(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert run("wrench", "--out", tmp_path / "wrench", "--stl", "~/wrench.stl").exit_code == 0
    assert (tmp_path / "wrench.stl").is_file()


@pytest.mark.thorough
def test_info_lists_what_a_provider_would_give(tmp_path):
    assert run("info", tmp_path).stdout == f"{tmp_path} holds no data sets\n"
    run("wrench", "--out", tmp_path / "wrench")
    scenes = starstruck_gen.SceneSetSpec(scenes=(("train", 6), ("test", 3)))
    starstruck_gen.generate(scenes, str(tmp_path / "stars"))
    (tmp_path / "notes").mkdir()
    (tmp_path / "damaged").mkdir()
    (tmp_path / "damaged" / "manifest.json").write_text("{")
    shown = run("info", tmp_path, "--json")
    found = {(entry["name"], entry["split"]): entry for entry in json.loads(shown.stdout)}
    assert set(found) == {("damaged", ""), ("stars", "train"), ("stars", "test"), ("wrench", "train")}
    assert "is damaged: " in found["damaged", ""]["problem"]
    stars = found["stars", "train"]
    assert (stars["kind"], stars["rows"], stars["classes"]) == ("starstruck", 6, ["1", "2", "3"])
    assert max(stars["largest_mm"]) <= 120
    wrench = found["wrench", "train"]
    assert wrench["largest_mm"][2] == pytest.approx(5.9)
    assert wrench["volume_mm3"][0] == wrench["volume_mm3"][1]
    assert "stars" in run("info", tmp_path).stdout
    assert run("info", tmp_path / "nowhere").exit_code == 2


@pytest.mark.thorough
def test_a_wrench_is_exported_for_printers_and_simulators(tmp_path):
    """Through the export of all data sets of meshes; the simulator weighs it as the report says."""
    made = run("wrench", "--size", 10, "--out", tmp_path / "wrench", "--json")
    mass_kg = 1e-3 * json.loads(made.stdout)["mass_g"]
    for kind, file in (("stl", "stl"), ("mjcf", "xml"), ("urdf", "urdf")):
        done = run("export", tmp_path / "wrench", "--format", kind, "--out", tmp_path / kind)
        assert done.exit_code == 0, done.output
        assert (tmp_path / kind / f"train-wrench-00000.{file}").is_file()
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "mjcf" / "train-wrench-00000.xml"))
    assert model.body_mass.sum() == pytest.approx(mass_kg, rel=1e-3)
    missing = run("export", tmp_path / "nowhere", "--out", tmp_path / "none")
    assert missing.exit_code == 2
    assert not (tmp_path / "none").exists()
