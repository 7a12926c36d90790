from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

import env_assets
import mnist3d
from env_assets import WrenchSpec, top_surface, wrench_mesh, write_wrench
from env_assets.wrench.dataset import wrench_schema
from tactile_toolkit import cards
from tactile_toolkit.cards.yaml_head import check_card
from tactile_toolkit.errors import InputError, SpecMismatchError
from tactile_toolkit.store import open_folder


def middles_mm(spec: WrenchSpec) -> tuple[tuple[float, float, float], ...]:
    """Positions of the nuts on the x axis, their widths, and the directions in which the jaws open."""
    lengths = spec.lengths()
    angle = math.radians(lengths["jaw_angle_deg"])
    return (
        ((lengths["length_mm"] - lengths["head_mm"]) / 2, spec.opening_mm, angle),
        ((lengths["second_head_mm"] - lengths["length_mm"]) / 2, spec.second_opening_mm, angle + math.pi),
    )


def nut(width_mm: float, turned_rad: float, clearance_mm: float = 0.0):
    """The hexagon of a nut, its flats parallel to the jaws."""
    from manifold3d import CrossSection

    angles = turned_rad + np.arange(6) * math.pi / 3
    corners = (width_mm + clearance_mm) / math.sqrt(3) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return CrossSection([corners])


def section_of(mesh, z_mm: float):
    return mesh.to_manifold().slice(z_mm)


@pytest.mark.parametrize("size", [(5.5, 7.0), (13.0, 10.0), (24.0, 21.0)])
def test_nuts_go_in_from_the_open_side_and_are_held(size):
    """The nut of each jaw touches no material where it sits and on its way out; a larger one does not fit."""
    spec = WrenchSpec(*size)
    section = section_of(wrench_mesh(spec), spec.lengths()["thickness_mm"] / 2)
    for middle_mm, width_mm, turned in middles_mm(spec):
        for way_mm in np.linspace(0, spec.lengths()["head_mm"], 9):
            place = (middle_mm + way_mm * math.cos(turned), way_mm * math.sin(turned))
            assert (section ^ nut(0.999 * width_mm, turned).translate(place)).area() < 0.02 * width_mm
        larger = nut(width_mm + 2 * spec.clearance_mm, turned).translate((middle_mm, 0))
        assert (section ^ larger).area() > 0.05 * width_mm
        # The jaws stop a nut that is turned inside them.
        tilted = nut(width_mm, turned + math.radians(12)).translate((middle_mm, 0))
        assert (section ^ tilted).area() > 0.01 * width_mm**2


def test_the_frame_is_that_of_a_pose():
    """Origin half way along, x towards the larger jaw, which is wider in y; z = 0 is the plate."""
    lengths = WrenchSpec().lengths()
    mesh = wrench_mesh(WrenchSpec())
    low, high = mesh.bounds_m * 1000
    assert low[2] == 0
    assert high[2] == pytest.approx(5.9)
    assert abs(low[0] + high[0]) < 0.5
    assert lengths["length_mm"] - 3 < high[0] - low[0] <= lengths["length_mm"]
    right = np.ptp(mesh.vertices_m[mesh.vertices_m[:, 0] > 0, 1])
    left = np.ptp(mesh.vertices_m[mesh.vertices_m[:, 0] < -0.06, 1])
    assert right == pytest.approx(lengths["head_mm"] / 1000, rel=0.01)
    assert left == pytest.approx(lengths["second_head_mm"] / 1000, rel=0.01)
    # The handle lies on the x axis and has its width there.
    handle = top_surface(mesh, 0.0001)
    across = handle.covered[:, np.abs(handle.x_m).argmin()]
    assert across.sum() * 0.1 == pytest.approx(lengths["handle_mm"], abs=0.15)
    assert handle.y_m[across].mean() == pytest.approx(0, abs=1e-4)


def test_top_and_bottom_are_alike_and_edges_are_cut():
    thickness_mm = WrenchSpec().lengths()["thickness_mm"]
    mesh = wrench_mesh(WrenchSpec())
    whole = section_of(mesh, thickness_mm / 2).area()
    for z_mm in (0.3, thickness_mm - 0.3):
        cut = section_of(mesh, z_mm)
        moved = section_of(mesh, thickness_mm / 2).offset(-0.3, miter_limit=4.0)
        assert cut.area() < whole
        assert (cut - moved).area() + (moved - cut).area() < 0.001 * whole


def test_the_default_wrench_is_unchanged():
    """Agents are trained and compared on this wrench."""
    assert WrenchSpec().lengths() == {
        "opening_mm": 13.0, "second_opening_mm": 10.0, "clearance_mm": 0.2, "length_mm": 157.5,
        "head_mm": 28.6, "second_head_mm": 22.0, "handle_mm": 10.5, "thickness_mm": 5.9,
        "fillet_mm": 10.4, "jaw_angle_deg": 15.0, "chamfer_mm": 0.6,
    }  # fmt: skip
    mesh = wrench_mesh(WrenchSpec())
    assert (len(mesh.vertices_m), len(mesh.faces)) == (2252, 4500)
    assert 1e9 * mesh.volume_m3 == pytest.approx(10194.905, rel=1e-6)


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


WIDTHS = st.one_of(st.floats(5, 60), st.sampled_from([5.0, 60.0]))


@settings(max_examples=settings.default.max_examples // 8)
@given(first=WIDTHS, second=WIDTHS, clearance=st.floats(0, 0.5))
def test_every_wrench_is_a_printable_solid_with_whole_jaws(first, second, clearance):
    assume(first != second)
    spec = WrenchSpec(first, second, clearance)
    mesh = wrench_mesh(spec)
    report = mnist3d.inspect(mesh, mnist3d.PrintProfile(plate_mm=(900.0, 900.0)))
    assert (report.is_solid, report.bodies, report.genus, report.warnings) == (True, 1, 0, ())
    assert report.thinnest_wall_mm >= 1.2
    rounded = {name: mm for name, mm in spec.lengths().items() if name not in spec.to_dict()}
    assert rounded == {name: round(mm, 3) for name, mm in rounded.items()}, "to a micrometre"
    assert report.size_mm[2] == pytest.approx(spec.lengths()["thickness_mm"], abs=1e-4)
    section = section_of(mesh, spec.lengths()["thickness_mm"] / 2)
    for middle_mm, width_mm, turned in middles_mm(spec):
        assert jaw_is_whole(section, middle_mm, width_mm + clearance, turned)


@pytest.mark.parametrize(
    ("lengths", "words"),
    [
        ({"opening_mm": 4.9}, "opening_mm of the wrench is 4.9; expected a number from 5 to 60"),
        ({"second_opening_mm": float("nan")}, "second_opening_mm of the wrench is nan"),
        ({"clearance_mm": 0.6}, "clearance_mm of the wrench is 0.6; expected a number from 0 to 0.5"),
        ({"opening_mm": 10}, "both ends of the wrench are alike .* next: choose another --second-opening-mm"),
    ],
)
def test_nuts_that_give_no_wrench_are_named(lengths, words):
    with pytest.raises(InputError, match=words):
        WrenchSpec(**lengths)


def test_a_written_wrench_is_whole_and_loads_everywhere(tmp_path):
    spec = WrenchSpec(16, 13)
    write_wrench(spec, str(tmp_path / "wrench"))
    mnist3d.write_mesh(tmp_path / "wrench.stl", wrench_mesh(spec))
    folder = open_folder(str(tmp_path / "wrench"))
    assert cards.verify(folder, wrench_schema()).ok
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

    write_wrench(WrenchSpec(), str(tmp_path / "wrench"))
    row = datasets.load_dataset(str(tmp_path / "wrench"), split="train", cache_dir=str(tmp_path / "hf"))[0]
    words = {name.removeprefix("mesh."): value for name, value in row.items() if name.startswith("mesh.")}
    mesh = trimesh.Trimesh(**words)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(row["volume_m3"], rel=1e-6)
    assert row["label"] == 0


@pytest.mark.thorough
def test_the_same_wrench_is_written_once_and_another_is_refused(tmp_path):
    folder = tmp_path / "wrench"
    write_wrench(WrenchSpec(), str(folder))
    before = {
        file: (file.stat().st_mtime_ns, file.read_bytes()) for file in folder.rglob("*") if file.is_file()
    }
    write_wrench(WrenchSpec(), str(folder))
    with pytest.raises(SpecMismatchError, match=r"opening_mm is 13\.0 there, 16\.0 was asked for"):
        write_wrench(WrenchSpec(16), str(folder))
    after = {
        file: (file.stat().st_mtime_ns, file.read_bytes()) for file in folder.rglob("*") if file.is_file()
    }
    assert after == before
    write_wrench(WrenchSpec(16), str(folder), overwrite=True)
    assert env_assets.AssetProvider(tmp_path).meshes("wrench")[0].opening_mm == 16
    write_wrench(WrenchSpec(16), str(tmp_path / "again"))
    name = "data/train-00000-of-00001.parquet"
    assert (tmp_path / "again" / name).read_bytes() == (folder / name).read_bytes()
