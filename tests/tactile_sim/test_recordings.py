"""Recordings of a user are read, and what is wrong with them is named."""

from __future__ import annotations

import csv
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import tactile_sim
from tactile_sim.twin.recordings import Recordings
from tactile_sim.twin.sources import image_paths
from tactile_toolkit.errors import InputError, ToolkitError
from tests.command_line import call
from tests.tactile_sim.hidden_recordings import Recording
from tests.tactile_sim.hidden_sensors import MISTAKES, Family, digits, draw_sensor
from tests.tactile_sim.twin_scores import recordings_of

SIZE = (120, 90)


@cache
def record(
    family: Family = "phong", mistake: str | None = None, seed: int = 3, touches: int = 12
) -> Recording:
    return draw_sensor(seed, family, SIZE).record(digits(3), touches, mistake=mistake)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return record(touches=8)


@pytest.fixture
def folder(recording: Recording, tmp_path: Path) -> Path:
    recording.write(tmp_path)
    return tmp_path


def same(found: Recordings, made: Recording) -> None:
    np.testing.assert_array_equal(found.images, made.images)
    np.testing.assert_array_equal(found.object_ids, made.object_ids)
    np.testing.assert_allclose(found.poses_on_solids(), recordings_of(made).poses_on_solids(), atol=1e-9)


def test_a_folder_of_images_with_a_table_is_read(folder: Path, recording: Recording) -> None:
    found = tactile_sim.read_recordings(
        folder / "images", folder / "solids", backgrounds=[folder / "backgrounds"]
    )
    same(found, recording)
    np.testing.assert_array_equal(found.backgrounds, recording.backgrounds)
    assert found.sensor_m is not None
    np.testing.assert_allclose(found.sensor_m, recording.sensor_m, atol=1e-12)
    assert found.names[2] == "0002.png"
    for number, solid in found.solids.items():
        np.testing.assert_allclose(solid.bounds_m, recording.solids[number].bounds_m, atol=1e-6)


def test_lengths_and_turns_may_have_other_units(folder: Path, recording: Recording) -> None:
    file = folder / "images" / "touches.csv"
    with file.open() as stream:
        rows = list(csv.DictReader(stream))
    with (folder / "other.csv").open("w", newline="") as stream:
        table = csv.writer(stream, delimiter=";")
        table.writerow(["file", "object_id", "x_mm", "y_mm", "object_x_mm", "object_y_mm", "object_turn_deg"])
        for row in rows:
            lengths = [1e3 * float(row[name]) for name in ("x_m", "y_m", "object_x_m", "object_y_m")]
            turn = np.degrees(float(row["object_turn_rad"]))
            table.writerow([row["file"], row["object"], *lengths, turn])
    found = tactile_sim.read_recordings(folder / "images", folder / "solids", table=folder / "other.csv")
    same(found, recording)
    assert found.sensor_m is not None
    assert np.isnan(found.sensor_m[:, 2]).all()
    assert not found.backgrounds.size
    (folder / "some.csv").write_text("file,object,x_m,y_m,object_x_mm\n0000.png,0,0.001,0.002,3\n")
    found = tactile_sim.read_recordings(folder / "images", folder / "solids", table=folder / "some.csv")
    assert found.object_poses is not None
    assert found.object_poses.tolist() == [[0.003, 0, 0]], "what is not stated of a pose is 0"


def test_an_imported_data_set_is_read_like_the_folder(folder: Path, recording: Recording) -> None:
    out = folder / "set"
    table = folder / "images" / "touches.csv"
    assert call("realtouch", "import", folder / "images", "--table", table, "--out", out, "-q") == 0
    same(tactile_sim.read_recordings(out, folder / "solids"), recording)


def test_touches_of_our_own_are_read_with_their_poses(folder: Path) -> None:
    plan = tactile_sim.TouchPlan(1, 2, "object", seed=4)
    spec = tactile_sim.TouchSetSpec((64, 48), "depth", "full", plan, image_format="png")
    tactile_sim.generate(folder / "solids", spec, folder / "made")
    found = tactile_sim.read_recordings(folder / "made", folder / "solids")
    assert found.object_ids.tolist() == [0, 0, 1, 1, 2, 2]
    # Where a sensor sees contact, the solid is: poses mean what the generator means by them.
    assert [each.kind for each in tactile_sim.find_mistakes(found) if each.kind in ("mesh", "mirrored")] == []


def test_images_alone_have_no_poses_and_one_solid_needs_no_name(folder: Path) -> None:
    (folder / "images" / "touches.csv").unlink()
    found = tactile_sim.read_recordings(folder / "images", folder / "solids" / "000.stl")
    assert found.sensor_m is None
    assert set(found.object_ids.tolist()) == {0}
    with pytest.raises(InputError, match="does not name the solid"):
        tactile_sim.read_recordings(folder / "images", folder / "solids")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("file,object\n../outside.png,0\n", "outside"),
        ("file,object\nabsent.png,0\n", r"there is no image .*absent\.png"),
        ("file,object,x_m\n0000.png,0,far\n", r"line 2: x_m is 'far'; expected a number"),
        ("file,object,x_m\n0000.png,0,1.5\n0001.png,0,far\n", r"line 3: x_m is 'far'; expected a number"),
        ('file,object,x_m\n0000.png,0,"1,234"\n', r"line 2: x_m is '1,234'; expected a number"),
        ("file,object,x_m\n0000.png,0,1_0\n", r"line 2: x_m is '1_0'; expected a number"),
        ("file,object,x_m\n0000.png,0,inf\n", r"line 2: x_m is inf; expected a number"),
        ("file,object\n0000.png,1.5\n", r"line 2: object is 1\.5; expected the id of a solid"),
        ("image,object\n0000.png,0\n", "expected file, and of each touch object"),
        ("file,object\n0000.png,9\n", "solids 9 were touched"),
        ("file,object,x_m,y_m\n0000.png,0,0,0\n0001.png,0,0,\n", "1 of 2 touches have no position"),
    ],
)
def test_tables_that_cannot_be_meant_are_refused(folder: Path, change: str, message: str) -> None:
    (folder / "images" / "touches.csv").write_text(change)
    with pytest.raises(ToolkitError, match=message):
        tactile_sim.read_recordings(folder / "images", folder / "solids")


def test_a_folder_of_a_data_set_holds_no_image_files(folder: Path) -> None:
    assert len(image_paths(folder / "images")) == 8
    (folder / "images" / "manifest.json").write_text("{}")
    assert image_paths(folder / "images") == []


@pytest.mark.parametrize("has_backgrounds", [True, pytest.param(False, marks=pytest.mark.thorough)])
@pytest.mark.parametrize("mistake", [None, *MISTAKES])
def test_each_mistake_is_named_and_no_other(mistake: str | None, has_backgrounds: bool) -> None:
    if mistake == "channels" and not has_backgrounds:
        pytest.skip("without images of the gel at rest, another order of the channels is another sensor")
    found = tactile_sim.find_mistakes(recordings_of(record(mistake=mistake), has_backgrounds=has_backgrounds))
    assert [each.kind for each in found] == [mistake] * (mistake is not None)
    assert all(any(letter.isdigit() for letter in str(each)) for each in found)  # the figure that shows it


@pytest.mark.thorough
@pytest.mark.sim
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("family", ["taxim", "phong"])
def test_mistakes_of_many_sensors(family: Family, seed: int) -> None:
    for mistake in (None, *MISTAKES):
        found = tactile_sim.find_mistakes(recordings_of(record(family, mistake, seed)))
        assert {each.kind for each in found} == {mistake} - {None}, mistake


@pytest.mark.parametrize(("mistake", "named"), [(None, []), ("gel-changed", ["gel-changed"])])
def test_contacts_of_few_touches_are_no_change_of_the_gel(mistake: str | None, named: list[str]) -> None:
    """Medians of five images show contacts, more strongly than some gels that changed."""
    made = draw_sensor(1, "phong", (160, 120)).record(digits(4, 5), 10, seed=1, mistake=mistake)
    assert [each.kind for each in tactile_sim.find_mistakes(recordings_of(made))] == named
    made.images[:5] = 255  # these show no gel
    assert "gel-changed" not in {each.kind for each in tactile_sim.find_mistakes(recordings_of(made))}


@pytest.mark.parametrize(("moved_m", "named"), [(-0.02, ["heights"]), (0.02, ["heights"]), (5e-4, [])])
def test_heights_that_no_gel_allows_are_named(moved_m: float, named: list[str]) -> None:
    made = record()
    moved = replace(made, sensor_m=made.sensor_m + np.array([0.0, 0.0, moved_m]))
    assert [mistake.kind for mistake in tactile_sim.find_mistakes(recordings_of(moved))] == named
    moved.sensor_m[:, 2] = 0.0  # as in a table without heights
    (mistake,) = tactile_sim.find_mistakes(recordings_of(moved))
    assert (mistake.kind, mistake.is_fatal) == ("heights", False)


def test_a_solid_that_is_not_there_is_named() -> None:
    made = record()
    others = {key: solid for key, solid in enumerate(digits(7, seed=40).values()) if key >= 4}
    strange = {key: others[key + 4] for key in range(3)}
    (found,) = tactile_sim.find_mistakes(recordings_of(replace(made, solids=strange)))
    assert found.kind == "mesh"
    assert "agree by 0." in str(found)
