"""Names in manifests, records and links: they never lead to files outside of the folder."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path, PurePosixPath, PureWindowsPath

import pytest
from hypothesis import given, strategies as st

from tactile_toolkit.errors import InputError, IntegrityError, StorageError
from tactile_toolkit.places import open_place
from tactile_toolkit.store import build, is_hidden, names_inside, open_folder, problem_of_name, verify
from tactile_toolkit.store.verification import RECORD_FILE, read_download_record
from tests.sealed import sealed
from tests.tactile_toolkit.toy import SCHEMA, folder_bytes, toy_plan

WILD = [
    *("../victim", "reports/../../victim", "/etc/passwd", "/dev/zero", "..", ".", ""),
    *("reports//x", "./reports/x", "reports/", "..\\victim", "reports\\..\\..\\victim"),
    *("\\\\server\\share\\x", "C:\\victim", "C:victim", "c:/victim"),
    *("reports/x\0.txt", "reports/x\n.txt", "reports/\x1b[2J", "reports/\u202etxt.exe", "reports/\udcff"),
    *(".git", ".git/config", "reports/.hidden", ".pending/x.json", ".download.json"),
    *("CON", "reports/nul.parquet", "reports/com¹.txt", "aux .txt", "reports/x.", "reports/x "),
    *("reports/" + "x" * 151, "/".join("x" * 100 for _ in range(11)), 7, None, ["reports/x"]),
]
SOME = ["../victim", "reports/../../victim", "/etc/passwd", ".git", "C:\\victim", "reports/nul.parquet"]
FINE = [
    "data/train-00000-of-00002.parquet",
    "reports/printability.parquet",
    "images/train/日本 ü.1/000.png",
    "images/train/2024-01-01T10:00:00/000.png",
    "console.txt",
    "x" * 150,
]


@pytest.mark.parametrize("name", WILD)
def test_a_wild_name_is_refused_by_name(name):
    with pytest.raises(IntegrityError, match="here names the file") as told:
        names_inside(["reports/fine.parquet", name], "here")
    assert str(told.value).isprintable()
    assert len(str(told.value)) < 400


@pytest.mark.parametrize(
    ("path", "hidden"),
    [
        ("._a.png", True),
        ("7/.DS_Store", True),
        ("__MACOSX/7/a.png", True),
        ("7/@eaDir/a.png", True),
        ("THUMBS.DB", True),
        ("7/desktop.ini", True),
        ("7/a.png", False),
        ("7/thumbs.db.png", False),
        ("a.b/c", False),
    ],
)
def test_files_of_operating_systems_are_ignored(path: str, hidden: bool) -> None:
    assert is_hidden(path) is hidden


def test_plain_names_pass():
    assert names_inside(FINE, "here") == tuple(FINE)


@pytest.mark.parametrize(
    ("one", "other"),
    [("data/A.parquet", "data/a.parquet"), ("Straße", "STRASSE"), ("e\u0301", "é")],
    ids=["case", "folding", "normal form"],
)
def test_two_names_of_one_file_are_refused(one, other):
    with pytest.raises(IntegrityError, match="is the same file as"):
        names_inside([one, other], "here")
    assert names_inside([one, one], "here") == (one,)


parts = st.sampled_from(["..", ".", "", "a", "C:", "\\", "..\\", "~", "nul", "a\0", "é", "/"]) | st.text(
    max_size=8
)


@given(st.lists(parts, min_size=1, max_size=6).map("/".join))
def test_accepted_names_stay_inside_on_every_system(name):
    if problem_of_name(name):
        return
    for path in (PurePosixPath(name), PureWindowsPath(name)):
        assert not path.is_absolute()
        assert not path.drive
        assert not path.root
        assert ".." not in path.parts
        assert path.as_posix() == name


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    place = tmp_path_factory.mktemp("built") / "set"
    build(open_folder(str(place)), toy_plan())
    return place


@pytest.fixture
def finished(built, tmp_path):
    """A finished set next to files of a user."""
    shutil.copytree(built, tmp_path / "set")
    (tmp_path / "victim").write_text("years of work")
    return tmp_path / "set"


def edited(folder: Path, **changes: object) -> None:
    values = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(sealed({**values, **changes}))


@pytest.mark.parametrize("field", ["files", "trees", "shards"])
@pytest.mark.parametrize("name", SOME)
def test_a_hostile_manifest_is_refused_and_nothing_is_changed(finished, tmp_path, field, name):
    """Verifying, opening and continuing all begin with reading the manifest."""
    shard = {**json.loads((finished / "manifest.json").read_text())["shards"][0], "file": name}
    wild = {"files": {name: "0" * 64}, "trees": [name], "shards": [shard]}
    edited(finished, **{field: wild[field]})
    before, words = folder_bytes(tmp_path), r"manifest\.json|damaged shard record"
    with pytest.raises(IntegrityError, match=words):
        verify(open_folder(str(finished)))
    with pytest.raises(IntegrityError, match=words):
        open_place(str(finished)).shards("train")
    with pytest.raises(IntegrityError, match=words):
        build(open_folder(str(finished)), toy_plan())
    assert folder_bytes(tmp_path) == before
    build(open_folder(str(finished)), toy_plan(spec={"seed": 2}), overwrite=True)
    assert (tmp_path / "victim").read_text() == "years of work"


@pytest.mark.parametrize("digest", ["../../../evil", "0" * 63, "0" * 64 + "\n", "G" * 64, 0, None])
@pytest.mark.parametrize("field", ["files", "shards"])
def test_digests_of_a_manifest_are_digests(finished, field, digest):
    shards = json.loads((finished / "manifest.json").read_text())["shards"]
    shards[0]["sha256"] = digest
    edited(finished, **({"shards": shards} if field == "shards" else {"files": {"reports/x": digest}}))
    with pytest.raises(IntegrityError, match=r"manifest\.json.*Expected `str`.* at `\$\.(files|shards)"):
        verify(open_folder(str(finished)))


@pytest.mark.parametrize("name", ["notes", "data", "images", "index.csv"])
def test_overwriting_removes_only_files_of_data_sets(finished, name):
    """A manifest may list any file."""
    edited(finished, trees=[name])
    (finished / name).mkdir(exist_ok=True)
    (finished / name / "thesis.tex").write_text("years of work")
    before = folder_bytes(finished)
    with pytest.raises(InputError, match=rf"more than a data set .*\(found '{name}.*nothing was changed"):
        build(open_folder(str(finished)), toy_plan(spec={"seed": 2}), overwrite=True)
    assert folder_bytes(finished) == before


@pytest.mark.parametrize("name", SOME)
def test_a_wild_record_of_a_download_is_refused(tmp_path, name):
    file = {"bytes": 1, "digest": "0" * 64}
    values = {"repository": "a/b", "commit": "0" * 40, "revision": None, "splits": [], "labels": []}
    for wild in ({"files": {name: file}}, {"files": {}, "labels": [name]}):
        (tmp_path / RECORD_FILE).write_text(sealed({**values, **wild}))
        with pytest.raises(IntegrityError, match="names the file"):
            read_download_record(open_folder(str(tmp_path)))
    (tmp_path / RECORD_FILE).write_text(sealed({**values, "files": {"x": {**file, "digest": "../../x"}}}))
    with pytest.raises(IntegrityError, match="is not a digest"):
        read_download_record(open_folder(str(tmp_path)))


ACTIONS = {
    "exists": lambda folder, path: folder.exists(path),
    "names": lambda folder, path: folder.names(path),
    "size": lambda folder, path: folder.size_bytes(path),
    "open": lambda folder, path: folder.open(path),
    "read": lambda folder, path: folder.read_bytes(path),
    "write": lambda folder, path: folder.write_bytes(path, b""),
    "remove": lambda folder, path: folder.remove(path),
    "remove empty": lambda folder, path: folder.remove_empty(path),
    "address": lambda folder, path: folder.address(path),
}


@pytest.mark.parametrize("action", ACTIONS.values(), ids=ACTIONS.keys())
@pytest.mark.parametrize("remote", [False, True])
def test_a_folder_does_nothing_outside_of_itself(tmp_path, action, remote):
    """The last line of defence: even an unchecked name does not lead outside."""
    folder = open_folder("memory://bucket/set" if remote else str(tmp_path / "set"))
    (tmp_path / "victim").write_text("years of work")
    windows = (
        *(r"..\victim", r"data\..\..\victim", "C:victim", "data/c:/victim"),
        *("NUL", "data/com1.txt", "Aux /x"),
    )
    others = ("../victim", "data/../../victim", str(tmp_path / "victim"), "data/x\0y", "data/..")
    for path in (*others, *windows):
        with pytest.raises(StorageError, match="leads out of"):
            action(folder, path)
    assert folder_bytes(tmp_path) == {"victim": b"years of work"}


SHARD = "data/train-00001-of-00004.parquet"


def findings(folder: Path) -> dict[str, str]:
    return {each.file: each.problem for each in verify(open_folder(str(folder)), SCHEMA).findings}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
@pytest.mark.parametrize("path", [SHARD, "reports/toy.parquet"])
def test_pipes_and_devices_are_not_waited_for(finished, path):
    (finished / path).unlink()
    os.mkfifo(finished / path)
    assert findings(finished) == {path: "is not a file (it is a folder, a pipe or a device)"}
    with pytest.raises(IntegrityError, match="pipe or a device"):
        open_folder(str(finished)).open(path)
    (finished / path).unlink()
    (finished / path).symlink_to("/dev/zero")
    assert "leads out of the folder, to '/dev/zero'" in findings(finished)[path]


def test_targets_of_links_outside_are_not_read(finished, tmp_path):
    (tmp_path / "victim").write_bytes((finished / SHARD).read_bytes())
    (finished / SHARD).unlink()
    (finished / SHARD).symlink_to(tmp_path / "victim")
    assert "is a link that leads out of the folder" in findings(finished)[SHARD]
    (finished / SHARD).unlink()
    (finished / SHARD).symlink_to("nowhere")
    assert findings(finished) == {SHARD: "is missing"}


def test_links_inside_the_folder_and_of_the_hubs_cache_are_files(finished, tmp_path):
    (finished / "previews").mkdir()
    (finished / SHARD).rename(finished / "previews" / "moved")
    (finished / SHARD).symlink_to("../previews/moved")
    assert findings(finished) == {}
    blobs, snapshot = tmp_path / "cache" / "blobs", tmp_path / "cache" / "snapshots" / ("0" * 40)
    blobs.mkdir(parents=True)
    snapshot.parent.mkdir()
    finished.rename(snapshot)
    (snapshot / "previews" / "moved").rename(blobs / "of-the-hub")
    (snapshot / SHARD).unlink()
    (snapshot / SHARD).symlink_to("../../../blobs/of-the-hub")
    assert findings(snapshot) == {}


@pytest.mark.skipif(not hasattr(os, "pathconf"), reason="needs a system that states its longest path")
def test_a_folder_whose_path_leaves_no_room_for_names_is_refused_before_the_work(tmp_path):
    longest, place = os.pathconf(tmp_path, "PC_PATH_MAX"), tmp_path
    while len(str(place)) < longest - 60:
        place /= "d" * min(200, longest - 60 - len(str(place)))
    made: list[object] = []
    with pytest.raises(InputError, match=r"characters, so that the system refuses .*; next: .*shorter path"):
        build(open_folder(str(place)), toy_plan(), on_progress=made.append)
    assert made == []
