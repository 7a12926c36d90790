from __future__ import annotations

import math
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st

import env_assets
import mnist3d
from env_assets.height_map import top_surface
from env_assets.wrench.making import wrench_schema, write_wrench
from env_assets.wrench.solid import wrench_mesh
from env_assets.wrench.spec import (
    LARGEST_MM,
    SMALLEST_MM,
    WIDTHS_ACROSS_FLATS_MM,
    WrenchSpec,
    next_smaller_mm,
    width_across_flats_mm,
)
from tactile_toolkit.cards import check_card
from tactile_toolkit.errors import InputError, SpecMismatchError, StorageError
from tactile_toolkit.store import open_folder, verify


def middles_mm(spec: WrenchSpec) -> tuple[tuple[float, float, float], ...]:
    """Where on the x axis the nuts sit, their width, and where the jaws open to."""
    first = ((spec.length_mm - spec.head_mm) / 2, spec.opening_mm, math.radians(spec.jaw_angle_deg))
    second = (
        (spec.second_head_mm - spec.length_mm) / 2,
        spec.second_opening_mm,
        math.radians(spec.jaw_angle_deg) + math.pi,
    )
    return (first, second) if spec.second_opening_mm else (first,)


def nut(width_mm: float, turned_rad: float, clearance_mm: float = 0.0):
    """The hexagon of a nut, its flats parallel to the jaws."""
    from manifold3d import CrossSection

    angles = turned_rad + np.arange(6) * math.pi / 3
    corners = (width_mm + clearance_mm) / math.sqrt(3) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return CrossSection([corners])


def section_of(mesh, z_mm: float):
    return mesh.to_manifold().slice(z_mm)


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("size", WIDTHS_ACROSS_FLATS_MM)
@pytest.mark.parametrize("single", [False, True])
def test_every_size_of_the_table_is_a_printable_solid(size, single):
    spec = WrenchSpec.for_size(size, single=single)
    report = mnist3d.inspect(wrench_mesh(spec), mnist3d.PrintProfile(plate_mm=(350.0, 350.0)))
    assert (report.is_solid, report.bodies, report.genus, report.warnings) == (True, 1, 0, ())
    assert report.thinnest_wall_mm >= 1.2
    assert report.size_mm[2] == pytest.approx(spec.thickness_mm, abs=1e-4)


@pytest.mark.parametrize("size", ["M3", "M8", "M16", 19])
def test_nuts_go_in_from_the_open_side_and_are_held(size):
    """The nut of each jaw touches no material where it sits and on its way out; a larger one does not fit."""
    spec = WrenchSpec.for_size(size)
    section = section_of(wrench_mesh(spec), spec.thickness_mm / 2)
    for middle_mm, width_mm, turned in middles_mm(spec):
        for way_mm in np.linspace(0, spec.head_mm, 9):
            place = (middle_mm + way_mm * math.cos(turned), way_mm * math.sin(turned))
            assert (section ^ nut(0.999 * width_mm, turned).translate(place)).area() < 0.02 * width_mm
        larger = nut(width_mm + 2 * spec.clearance_mm, turned).translate((middle_mm, 0))
        assert (section ^ larger).area() > 0.05 * width_mm
        # Turning the nut inside the jaws is what they are for: they stop it.
        tilted = nut(width_mm, turned + math.radians(12)).translate((middle_mm, 0))
        assert (section ^ tilted).area() > 0.01 * width_mm**2


def test_the_frame_is_that_of_a_pose():
    """Origin half way along, x towards the larger jaw, which is wider in y; z = 0 is the plate."""
    spec = WrenchSpec.for_size(13)
    mesh = wrench_mesh(spec)
    low, high = mesh.bounds_m * 1000
    assert low[2] == 0
    assert high[2] == pytest.approx(5.9)
    assert abs(low[0] + high[0]) < 0.5
    assert spec.length_mm - 3 < high[0] - low[0] <= spec.length_mm
    right = np.ptp(mesh.vertices_m[mesh.vertices_m[:, 0] > 0, 1])
    left = np.ptp(mesh.vertices_m[mesh.vertices_m[:, 0] < -0.06, 1])
    assert right == pytest.approx(spec.head_mm / 1000, rel=0.01)
    assert left == pytest.approx(spec.second_head_mm / 1000, rel=0.01)
    # The handle lies on the x axis and has its width there.
    handle = top_surface(mesh, 0.0001)
    across = handle.covered[:, np.abs(handle.x_m).argmin()]
    assert across.sum() * 0.1 == pytest.approx(spec.handle_mm, abs=0.15)
    assert handle.y_m[across].mean() == pytest.approx(0, abs=1e-4)


@settings(max_examples=settings.default.max_examples // 12)
@given(
    size=st.floats(SMALLEST_MM, LARGEST_MM),
    second=st.one_of(st.none(), st.floats(SMALLEST_MM, LARGEST_MM)),
    angle=st.floats(0, 90),
    chamfer=st.floats(0, 1.5),
    clearance=st.floats(0, 0.5),
)
def test_any_lengths_give_one_solid_or_are_refused(size, second, angle, chamfer, clearance):
    try:
        spec = WrenchSpec.for_size(
            size, second, jaw_angle_deg=angle, chamfer_mm=chamfer, clearance_mm=clearance
        )
        mesh = wrench_mesh(spec)
    except InputError:
        return
    report = mnist3d.inspect(mesh)
    assert (report.is_solid, report.bodies) == (True, 1)
    np.testing.assert_array_equal(wrench_mesh(WrenchSpec(**asdict(spec))).vertices_m, mesh.vertices_m)


def jaw_is_whole(section, middle_mm: float, width_mm: float, turned: float) -> bool:
    """Both sides of a jaw stand where the outer half of the nut's flats is, as far apart as they should."""
    from manifold3d import CrossSection

    def across(wide_mm: float, at_mm: float):
        strip = CrossSection.square((0.02, wide_mm)).translate((at_mm - 0.01, -wide_mm / 2))
        return strip.rotate(math.degrees(turned)).translate((middle_mm, 0))

    for at_mm in (0.05 * width_mm, 0.27 * width_mm):
        free, held = across(width_mm - 0.02, at_mm), across(width_mm + 0.22, at_mm)
        if (section ^ free).area() > 1e-6 or (section ^ held).area() < 0.02 * 0.2 * 0.99:
            return False
    return True


@settings(max_examples=settings.default.max_examples // 12)
@given(
    size=st.floats(SMALLEST_MM, LARGEST_MM),
    second=st.one_of(st.none(), st.floats(SMALLEST_MM, LARGEST_MM)),
    single=st.booleans(),
    lengths=st.fixed_dictionaries(
        {},
        optional={
            "jaw_angle_deg": st.floats(0, 90),
            "chamfer_mm": st.floats(0, 4),
            "clearance_mm": st.floats(0, 2),
            "fillet_mm": st.floats(0, 200),
            "handle_mm": st.floats(0.5, 40),
            "thickness_mm": st.floats(0.5, 30),
            "head_mm": st.floats(10, 150),
            "length_mm": st.floats(40, 500),
        },
    ),
)
@example(size=13, second=None, single=False, lengths={"chamfer_mm": 1.5})
@example(size=13, second=None, single=False, lengths={"chamfer_mm": 1.4})
@example(size=8.6, second=40.5, single=False, lengths={"chamfer_mm": 2.0})
@example(size=13, second=None, single=False, lengths={"handle_mm": 1.9})
def test_every_wrench_is_one_body_with_whole_jaws(size, second, single, lengths):
    try:
        spec = WrenchSpec.for_size(size, None if single else second, single=single, **lengths)
        mesh = wrench_mesh(spec)
    except InputError:
        return
    report = mnist3d.inspect(mesh)
    assert (report.is_solid, report.bodies) == (True, 1)
    section = section_of(mesh, spec.thickness_mm / 2)
    for middle_mm, width_mm, turned in middles_mm(spec):
        assert jaw_is_whole(section, middle_mm, width_mm + spec.clearance_mm, turned)


def test_a_large_chamfer_keeps_both_jaws_and_one_that_cannot_is_refused():
    kept = wrench_mesh(WrenchSpec.for_size(13, chamfer_mm=1.5)).bounds_m
    usual = wrench_mesh(WrenchSpec.for_size(13)).bounds_m
    np.testing.assert_allclose(np.ptp(kept, axis=0), np.ptp(usual, axis=0), atol=0.005)
    with pytest.raises(InputError, match=r"a chamfer of 3 mm .* next: choose a smaller"):
        wrench_mesh(WrenchSpec.for_size(13, chamfer_mm=3.0, thickness_mm=20.0, handle_mm=18.0))


@pytest.mark.parametrize(
    ("lengths", "words"),
    [
        ({"handle_mm": 1.9}, "handle_mm of the wrench is 1.9; expected more than 2.4, by chamfer_mm"),
        ({"thickness_mm": 0.0}, "thickness_mm of the wrench is 0.0; expected a number above 0"),
        ({"length_mm": float("nan")}, "length_mm of the wrench is nan"),
        ({"jaw_angle_deg": 91.0}, "jaw_angle_deg of the wrench is 91.0; expected a number from 0 to 90"),
        ({"head_mm": 15.0}, "head_mm of the wrench is 15; expected 18.8 or more for a jaw of 13"),
        ({"handle_mm": 25.0}, "handle_mm of the wrench is 25; expected at most second_head_mm"),
        ({"length_mm": 40.0}, "length_mm of the wrench is 40; expected 50.6 or more"),
        ({"chamfer_mm": 3.0}, "chamfer_mm of the wrench is 3; expected at most .*, 0.4 of thickness_mm"),
    ],
)
def test_lengths_that_give_no_wrench_are_named(lengths, words):
    with pytest.raises(InputError, match=words):
        WrenchSpec.for_size(13, **lengths)


def test_ends_that_look_alike_are_refused():
    with pytest.raises(InputError, match="both ends of the wrench are alike"):
        WrenchSpec.for_size(13, 13)
    with pytest.raises(InputError, match="with a single jaw; next: give one of both"):
        WrenchSpec.for_size(13, 10, single=True)


def test_sizes_are_threads_or_widths():
    assert [width_across_flats_mm(size) for size in ("M8", " m10 ", 17, "5.5")] == [13, 16, 17, 5.5]
    assert [next_smaller_mm(width) for width in (13, 14, 5.5, 5)] == [10, 13, 7, 5.5]
    for size in ("M9", "8M", "nan", 4.9, 61, "", "1e9"):
        with pytest.raises(InputError, match=r"no wrench of size .* is made; expected a width across flats"):
            width_across_flats_mm(size)


def test_the_table_is_that_of_iso_272():
    """Two rules of thumb that hold over the whole of it: the head is 1.5 to 1.85 threads wide, and rises."""
    threads = [int(name[1:]) for name in WIDTHS_ACROSS_FLATS_MM]
    widths = list(WIDTHS_ACROSS_FLATS_MM.values())
    assert widths == sorted(set(widths))
    assert all(1.5 <= width / thread <= 1.85 for thread, width in zip(threads, widths, strict=True))


def test_a_written_wrench_is_whole_and_loads_everywhere(tmp_path):
    spec = WrenchSpec.for_size("M10")
    write_wrench(spec, str(tmp_path / "wrench"), mesh_file=tmp_path / "wrench.stl")
    folder = open_folder(str(tmp_path / "wrench"))
    assert verify(folder, wrench_schema(), check_card=check_card).ok
    assert check_card(folder) == []
    provider = env_assets.AssetProvider(tmp_path)
    (record,) = provider.meshes("wrench")
    assert isinstance(provider.meshes("wrench"), env_assets.WrenchDataset)
    assert (record.opening_mm, record.second_opening_mm) == (16.0, 13.0)
    assert record.volume_m3 == pytest.approx(record.mesh.volume, rel=1e-6)
    np.testing.assert_array_equal(record.vertices_m, wrench_mesh(spec).vertices_m)
    exported = mnist3d.read_mesh(tmp_path / "wrench.stl")
    assert exported.volume_m3 == pytest.approx(record.volume_m3, rel=1e-5)
    assert mnist3d.inspect(exported).is_solid


def test_the_published_way_of_loading_reads_it(tmp_path):
    """Every ``mesh.*`` column is handed to trimesh, as the published package does it."""
    import datasets
    import trimesh

    write_wrench(WrenchSpec.for_size(), str(tmp_path / "wrench"))
    row = datasets.load_dataset(str(tmp_path / "wrench"), split="train", cache_dir=str(tmp_path / "hf"))[0]
    words = {name.removeprefix("mesh."): value for name, value in row.items() if name.startswith("mesh.")}
    mesh = trimesh.Trimesh(**words)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(row["volume_m3"], rel=1e-6)
    assert row["label"] == 0


def test_the_same_wrench_is_written_once_and_another_is_refused(tmp_path):
    folder = tmp_path / "wrench"
    write_wrench(WrenchSpec.for_size(13), str(folder))
    before = {
        file: (file.stat().st_mtime_ns, file.read_bytes()) for file in folder.rglob("*") if file.is_file()
    }
    write_wrench(WrenchSpec.for_size(13), str(folder))
    with pytest.raises(SpecMismatchError, match=r"opening_mm is 13\.0 there, 16\.0 was asked for"):
        write_wrench(WrenchSpec.for_size(16), str(folder))
    after = {
        file: (file.stat().st_mtime_ns, file.read_bytes()) for file in folder.rglob("*") if file.is_file()
    }
    assert after == before
    write_wrench(WrenchSpec.for_size(16), str(folder), overwrite=True)
    assert env_assets.AssetProvider(tmp_path).meshes("wrench")[0].opening_mm == 16
    write_wrench(WrenchSpec.for_size(16), str(tmp_path / "again"))
    name = "data/train-00000-of-00001.parquet"
    assert (tmp_path / "again" / name).read_bytes() == (folder / name).read_bytes()


def test_what_cannot_be_written_is_refused_before_anything_is(tmp_path):
    with pytest.raises(InputError, match=r"wrench\.step"):
        write_wrench(WrenchSpec.for_size(), str(tmp_path / "wrench"), mesh_file=tmp_path / "wrench.step")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("place", ["folder.stl", "none/wrench.stl"])
def test_places_where_no_mesh_file_can_be_written(tmp_path, place):
    (tmp_path / "folder.stl").mkdir()
    with pytest.raises(StorageError, match=f"cannot write .*{place}"):
        write_wrench(WrenchSpec.for_size(), str(tmp_path / "wrench"), mesh_file=tmp_path / place)
    assert [path.name for path in tmp_path.iterdir()] == ["folder.stl"]
