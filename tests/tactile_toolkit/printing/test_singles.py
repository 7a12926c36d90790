"""One file for each object: each was read back as the same solid, and there are no other files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tactile_toolkit.catalog import id_range, id_text, parse_ids
from tactile_toolkit.errors import InputError, ItemError, StorageError
from tactile_toolkit.mesh import Mesh, MeshFile, check_manifold, read_mesh
from tactile_toolkit.mesh.solid_check import require_solid
from tactile_toolkit.printing import ExportOptions
from tactile_toolkit.printing.exports import export_files
from tactile_toolkit.printing.file_export import require_same_solid
from tests.tactile_toolkit.printing.solids import box, ell, named, open_box, ring
from tests.tactile_toolkit.toy import folder_bytes

SHAPES = [box(20, 10), ell(30, 8), ring(12, 6)]


@pytest.mark.parametrize("ending", MeshFile.FORMATS)
def test_every_format_comes_back_as_the_solid_on_the_plate(ending: str, tmp_path: Path) -> None:
    raised = [Mesh(mesh.vertices_m + np.array([0.1, 0.2, 0.05]), mesh.faces) for mesh in SHAPES]
    made = export_files(named(raised), str(tmp_path / "out"), ExportOptions(ending[1:]))
    assert made.failed == ()
    names = [f"test-{number}-{number:05d}{ending}" for number in range(3)]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == names
    for shape, file in zip(raised, made.files, strict=True):
        back = read_mesh(tmp_path / "out" / file.file)
        assert check_manifold(back).problem is None
        expected = shape.bounds_m - (0, 0, 0.05)
        assert back.bounds_m == pytest.approx(expected, abs=1e-7)
        assert file.size_mm == pytest.approx(np.ptp(shape.bounds_m, axis=0) * 1e3)
        assert back.volume_m3 == pytest.approx(shape.volume_m3, rel=1e-5)
        assert file.bytes == (tmp_path / "out" / file.file).stat().st_size


def test_broken_meshes_are_named_and_do_not_stop_the_others(tmp_path: Path) -> None:
    made = export_files(named([box(5, 5), open_box(5, 5), ring(4, 2)]), str(tmp_path), ExportOptions())
    assert [file.id for file in made.files] == [0, 2]
    (failure,) = made.failed
    assert (failure.name, failure.problem) == ("test-1-00001", "not-manifold")
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize(
    ("damage", "problem"),
    [
        (lambda mesh: Mesh(mesh.vertices_m, mesh.faces + 5), "index-out-of-range"),
        (lambda mesh: Mesh(mesh.vertices_m, mesh.faces - 1), "index-out-of-range"),
        (lambda mesh: Mesh(mesh.vertices_m * np.nan, mesh.faces), "not-finite"),
        (lambda mesh: Mesh(mesh.vertices_m[:0], mesh.faces[:0]), "empty"),
        (lambda mesh: Mesh(mesh.vertices_m, mesh.faces[:, ::-1]), "inside-out"),
    ],
)
def test_damaged_meshes_are_named_not_crashed_on(damage, problem: str, tmp_path: Path) -> None:
    made = export_files(named([damage(box(5, 5))]), str(tmp_path), ExportOptions())
    assert [failure.problem for failure in made.failed] == [problem]
    assert list(tmp_path.iterdir()) == []


def test_a_solid_that_the_format_cannot_hold_leaves_no_file(tmp_path: Path) -> None:
    """Far from the origin, corners of a small solid coincide in single precision."""
    small = box(0.05, 0.05, 0.05)
    away = Mesh(small.vertices_m + np.array([5_000.0, 0.0, 0.0]), small.faces)
    assert check_manifold(away.on_plate()).problem is None
    made = export_files(named([away, box(5, 5)]), str(tmp_path), ExportOptions("stl"))
    assert [path.name for path in tmp_path.iterdir()] == ["test-1-00001.stl"]
    (failure,) = made.failed
    assert "it does not bound a solid" in failure.detail
    assert export_files(named([away]), str(tmp_path / "exact"), ExportOptions("3mf")).failed == ()


def test_a_disk_that_changes_bytes_keeps_the_former_file(tmp_path, monkeypatch):
    export_files(named([box(7, 7), box(5, 5)]), str(tmp_path), ExportOptions())
    before = folder_bytes(tmp_path)
    read = Path.read_bytes
    monkeypatch.setattr(
        Path, "read_bytes", lambda path: read(path) + (b"" if path.name.startswith("test") else b"!")
    )
    made = export_files(named([box(8, 8), box(5, 5)]), str(tmp_path), ExportOptions(), overwrite=True)
    (failure,) = made.failed
    assert (failure.name, failure.problem) == ("test-0-00000", "changed")
    assert "reads back from disk with other bytes; the file was removed" in failure.detail
    (kept,) = folder_bytes(tmp_path).items()
    assert kept in before.items()


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("workers", [1, 2])
def test_a_continued_run_keeps_files_and_gives_the_same_bytes(tmp_path: Path, workers: int) -> None:
    export_files(named(SHAPES), str(tmp_path / "whole"), ExportOptions())
    export_files(named(SHAPES)[:2], str(tmp_path / "parts"), ExportOptions())
    stamps = {path: path.stat().st_mtime_ns for path in (tmp_path / "parts").iterdir()}
    made = export_files(named(SHAPES), str(tmp_path / "parts"), ExportOptions(), workers=workers)
    assert [file.state for file in made.files] == ["kept", "kept", "written"]
    assert stamps == {path: path.stat().st_mtime_ns for path in stamps}
    assert folder_bytes(tmp_path / "parts") == folder_bytes(tmp_path / "whole")


def test_other_content_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    export_files(named(SHAPES)[1:], str(tmp_path), ExportOptions(scale=2))
    before = folder_bytes(tmp_path)
    with pytest.raises(InputError, match=r"test-1-00001\.stl.*2 such files.*--overwrite"):
        export_files(named(SHAPES), str(tmp_path), ExportOptions())
    assert folder_bytes(tmp_path) == before
    made = export_files(named(SHAPES), str(tmp_path), ExportOptions(), overwrite=True)
    assert [file.state for file in made.files] == ["written"] * 3
    export_files(named(SHAPES), str(tmp_path / "fresh"), ExportOptions())
    assert folder_bytes(tmp_path / "fresh") == {
        name: content for name, content in folder_bytes(tmp_path).items() if "fresh" not in str(name)
    }


def test_the_former_file_of_a_failed_object_is_removed(tmp_path: Path) -> None:
    export_files(named([box(5, 5), box(7, 7)]), str(tmp_path), ExportOptions())
    made = export_files(named([box(5, 5), open_box(5, 5)]), str(tmp_path), ExportOptions(), overwrite=True)
    (failure,) = made.failed
    assert "test-1-00001.stl of an earlier export was removed" in failure.detail
    assert [path.name for path in tmp_path.iterdir()] == ["test-0-00000.stl"]


def test_a_dry_run_returns_the_result_of_the_run_and_writes_nothing(tmp_path: Path) -> None:
    objects, out = named(SHAPES), tmp_path / "out"
    view = export_files(objects, str(out), ExportOptions(), dry_run=True)
    assert list(tmp_path.iterdir()) == []
    made = export_files(objects[:1], str(out), ExportOptions())
    again = export_files(objects, str(out), ExportOptions(), dry_run=True)
    assert [file.state for file in again.files] == ["kept", "planned", "planned"]
    assert len(list(out.iterdir())) == 1
    assert [replace(file, state="written") for file in again.files[:1]] == list(made.files)
    made = export_files(objects, str(out), ExportOptions(), overwrite=True)
    assert [replace(file, state="planned") for file in made.files] == list(view.files)
    away = Mesh(box(0.05, 0.05, 0.05).vertices_m + np.array([5_000.0, 0.0, 0.0]), box(1, 1).faces)
    (failure,) = export_files(named([away]), str(tmp_path / "none"), ExportOptions(), dry_run=True).failed
    assert "it does not bound a solid" in failure.detail, "as it would read back"


@pytest.mark.parametrize("scale", [0, -1, float("nan"), float("inf")])
def test_scales_that_give_no_solid_are_refused(scale: float, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="scale of the export is"):
        export_files(named(SHAPES), str(tmp_path / "out"), ExportOptions(scale=scale))
    assert list(tmp_path.iterdir()) == []


def test_bad_places_and_formats_are_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="is a file"):
        export_files(named(SHAPES), str(tmp_path / "file"), ExportOptions())
    with pytest.raises(StorageError, match="Not a directory"):
        export_files(named(SHAPES), str(tmp_path / "file" / "below"), ExportOptions())
    with pytest.raises(InputError, match="memory://"):
        export_files(named(SHAPES), "memory://prints", ExportOptions())
    formats = "stl, 3mf, ply, obj, glb, mjcf, urdf, usd"
    with pytest.raises(
        InputError, match=f"file_format of the export is 'step'; expected None or one of {formats}$"
    ):
        export_files(named(SHAPES), str(tmp_path / "out"), ExportOptions("step"))
    (name,) = [item.name for item in named(SHAPES)[:1]]
    (tmp_path / "files").mkdir()
    (tmp_path / "files" / name).write_text("where the folder of the parts should be")
    with pytest.raises(StorageError, match="Not a directory"):
        export_files(named(SHAPES)[:1], str(tmp_path / "files"), ExportOptions("urdf"))
    (tmp_path / "folders" / f"{name}.stl").mkdir(parents=True)
    with pytest.raises(StorageError, match=r"\.stl'.*Is a directory"):
        export_files(named(SHAPES)[:1], str(tmp_path / "folders"), ExportOptions())


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        *(("3", [3]), ("3, 17,40-42", [3, 17, (40, 42)]), ("-5", [-5]), ("7-7", [(7, 7)])),
        ("0-99999999999999999999", [(0, 10**20 - 1)]),
    ],
)
def test_ids_are_numbers_and_ranges(text: str, numbers: list[int | tuple[int, int]]) -> None:
    assert parse_ids(text) == numbers


@pytest.mark.parametrize("text", ["", "a", "1,,2", "5-3", "1-2-3", "1.5"])
def test_other_ids_are_no_numbers(text: str) -> None:
    with pytest.raises(InputError, match="ids has"):
        list(map(id_range, parse_ids(text)))


@pytest.mark.parametrize(
    "text", ["a", "2023-09-28_15-50-43_7-0", "5-3", "3-5", "007", "007-9", "+3", "1.5", "-3"]
)
def test_ids_of_text_are_kept(text: str) -> None:
    assert id_text(parse_ids(f" {text} ,3")[0]) == text


def test_another_solid_is_noticed() -> None:
    """The numbers of bodies and holes, the bounds and the volume are all compared."""
    meant = box(10, 10)
    require_same_solid(meant, meant, require_solid(meant))
    moved = Mesh(meant.vertices_m + 1e-3, meant.faces)
    for found, words in (
        (ring(5, 2), "it has 1 bodies and 1 holes; 1 and 0 were written"),
        (ell(10, 9), "its volume is 495"),
        (moved, "its bounds moved by 1 mm"),
    ):
        with pytest.raises(ItemError, match=words) as caught:
            require_same_solid(found, meant, require_solid(meant))
        assert caught.value.reason == "changed"
