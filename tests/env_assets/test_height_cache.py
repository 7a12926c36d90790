from __future__ import annotations

import os
import zlib

import numpy as np
import pytest

from tactile_toolkit.mesh.height_map import HeightCache, content_key, top_surface
from tactile_toolkit.mesh.mesh import Mesh
from tests.env_assets.shapes import box, cylinder
from tests.forked import start_forked

PITCH = 0.5


@pytest.fixture
def cache(tmp_path):
    return HeightCache(tmp_path / "heights")


def files(cache):
    return sorted(cache.folder.glob("[!.]*"))


def test_what_was_made_once_is_read_again(cache):
    mesh = cylinder(3.0, 2.0, 9)
    made = cache.get(mesh, PITCH)
    (file,) = files(cache)
    # A mark in the file, with its checksum, shows in what is given the second time: it was read, not made.
    marked = made.heights_m.copy()
    marked[0, 0] = 77
    values = marked.astype("<f4").tobytes()
    file.write_bytes(values + zlib.crc32(values).to_bytes(4, "little"))
    again = cache.get(mesh, PITCH)
    assert again.heights_m[0, 0] == 77
    assert again.window == made.window
    assert not again.heights_m.flags.writeable


def test_content_and_pitch_make_the_name(cache):
    mesh = box((0, 0, 0), (2, 2, 1))
    moved = Mesh(mesh.vertices_m + 1e-7, mesh.faces)
    turned = Mesh(mesh.vertices_m, mesh.faces[::-1])
    halved = Mesh(mesh.vertices_m.astype(np.float32), mesh.faces)
    keys = {content_key(m, PITCH) for m in (mesh, moved, turned, halved)} | {content_key(mesh, 0.25)}
    assert len(keys) == 5
    assert content_key(Mesh(mesh.vertices_m.copy(), mesh.faces.copy()), PITCH) == content_key(mesh, PITCH)
    strided = Mesh(np.asfortranarray(mesh.vertices_m), np.asfortranarray(mesh.faces))
    assert content_key(strided, PITCH) == content_key(mesh, PITCH)


@pytest.mark.parametrize("damage", [b"", b"short", None])
def test_a_damaged_file_is_made_again(cache, damage):
    mesh = cylinder(3.0, 2.0, 9)
    expected = cache.get(mesh, PITCH).heights_m
    (file,) = files(cache)
    whole = file.read_bytes()
    flipped = bytes([whole[0] ^ 1]) + whole[1:]
    file.write_bytes(flipped if damage is None else damage)
    np.testing.assert_array_equal(cache.get(mesh, PITCH).heights_m, expected)
    assert file.read_bytes() == whole


def test_a_folder_that_cannot_be_written_costs_no_map(tmp_path):
    (tmp_path / "taken").write_text("a file where the folder would be")
    mesh = box((0, 0, 0), (2, 2, 1))
    found = HeightCache(tmp_path / "taken").get(mesh, PITCH)
    np.testing.assert_array_equal(found.heights_m, top_surface(mesh, PITCH).heights_m)


def test_the_least_used_leave_first_and_the_limit_holds(tmp_path):
    meshes = [box((0, 0, 0), (4, 4, height)) for height in range(1, 21)]
    size = 4 * 64 + 4
    cache = HeightCache(tmp_path / "heights", limit_bytes=10 * size)
    cache.get(meshes[0], PITCH)
    for place, mesh in enumerate(meshes[1:], start=1):
        (cache.folder / f"{content_key(mesh, PITCH)}.heights").unlink(missing_ok=True)
        cache.get(mesh, PITCH)
        cache.get(meshes[0], PITCH)  # used all the time: it has to stay
        for age, older in enumerate(reversed(meshes[1 : place + 1])):
            file = cache.folder / f"{content_key(older, PITCH)}.heights"
            if file.exists():
                os.utime(file, ns=(0, (1000 - age) * 10**9))
        assert sum(file.stat().st_size for file in files(cache)) <= cache.limit_bytes
    kept = {file.stem for file in files(cache)}
    assert content_key(meshes[0], PITCH) in kept
    assert content_key(meshes[-1], PITCH) in kept
    assert content_key(meshes[1], PITCH) not in kept
    assert len(kept) >= 5


def test_leavings_of_killed_writers_leave_too(tmp_path):
    cache = HeightCache(tmp_path / "heights", limit_bytes=1000)
    cache.folder.mkdir()
    left = cache.folder / ".writing-0123456789abcdef0123456789abcdef-x.heights"
    left.write_bytes(bytes(2000))
    cache.get(box((0, 0, 0), (2, 2, 1)), PITCH)
    assert not left.exists()


SHARE = """
import sys, zlib
from pathlib import Path
from tactile_toolkit.mesh.height_map import HeightCache
from tests.env_assets.shapes import cylinder
cache = HeightCache(Path(sys.argv[1]), limit_bytes=40_000)
digest = 0
for turn in range(3):
    for sides in range(5, 30):
        digest = zlib.crc32(cache.get(cylinder(10.0, sides, sides), 0.5).heights_m.tobytes(), digest)
print(digest)
"""


def test_processes_share_a_full_folder(tmp_path):
    """Several at once, in a folder too small for all: each gets every map right, and no error."""
    running = [start_forked(SHARE, tmp_path / "heights") for _ in range(3)]
    assert [process.end() for process in running] == [0, 0, 0], [process.err for process in running]
    assert len({process.out for process in running}) == 1
