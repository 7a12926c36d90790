"""Uploads to a real server: only missing files are sent, and arrived files are verified."""

from __future__ import annotations

import hashlib
import shutil
import signal
import time
from pathlib import Path

import pytest

from starstruck_gen.scene_dataset import SceneSetSpec, generate
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.exchange import Upload, UploadOptions
from tactile_toolkit.store import open_folder, read_manifest
from tests.hub_server import HubServer
from tests.tactile_toolkit.hub.client import settings, start_here
from tests.tactile_toolkit.toy import folder_bytes

NAME = "someone/stars"

pytestmark = pytest.mark.filterwarnings(
    "ignore:Use 'content=<...>':DeprecationWarning"  # made by the client, in every PUT
)


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """Three shards of train, one of test: 2,010 and 9 scenes."""
    folder = tmp_path_factory.mktemp("upload") / "stars"
    generate(SceneSetSpec(scenes=(("train", 2_010), ("test", 9))), str(folder))
    return folder


@pytest.fixture
def folder(made, tmp_path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "stars"))


def upload(folder: Path, name: str = NAME, **options: object):
    return Upload.of_folder(str(folder), name, UploadOptions(**options)).send()  # type: ignore[arg-type]


def sent_objects(server: HubServer) -> list[str]:
    return [request.path.rpartition("/")[2] for request in server.requests if request.method == "PUT"]


def shards_of(folder: Path) -> dict[str, str]:
    return {f"data/{file.name}": _sha256(file) for file in sorted((folder / "data").iterdir())}


def _sha256(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def assert_holds(server: HubServer, folder: Path, name: str = NAME, revision: str = "main") -> None:
    """Assert that all files of the folder are there, byte for byte, and the card names the repository."""
    held = server.repository(name).find(revision)
    assert held is not None
    expected = {f.relative_to(folder).as_posix(): f.read_bytes() for f in folder.rglob("*") if f.is_file()}
    expected["README.md"] = expected["README.md"].replace(b'"FOLDER"', f'"{name}"'.encode())
    assert {path: blob.content for path, blob in held.files.items() if path in expected} == expected


def test_everything_arrives_once_and_then_nothing_is_sent(server, folder):
    first = upload(folder)
    assert_holds(server, folder)
    assert first.commit == server.repository(NAME).head.sha
    assert set(first.sent) == set(server.repository(NAME).head.files)
    assert server.repository(NAME).tags == {}
    server.requests.clear()
    again = upload(folder)
    assert (again.commit, again.sent, again.removed, again.options.tag) == (first.commit, (), (), None)
    assert {request.method for request in server.requests} == {"GET"}
    assert len(server.repository(NAME).history) == 2, "the first commit and ours"


def test_only_what_changed_is_sent(server, folder):
    upload(folder)
    (folder / "previews" / "scenes.png").unlink()
    with (folder / "README.md").open("a") as card:
        card.write("\nA line by hand.\n")
    from starstruck_gen.scene_card import write_card

    text = (folder / "README.md").read_text()
    manifest = read_manifest(open_folder(str(folder)))
    assert manifest is not None
    write_card(open_folder(str(folder)), manifest)
    (folder / "README.md").write_text(text)
    server.requests.clear()
    assert upload(folder).sent == ("README.md",)
    assert sent_objects(server) == []
    assert server.repository(NAME).head.files["README.md"].content.endswith(b"A line by hand.\n")


def test_files_of_others_are_kept_unless_asked(server, folder):
    server.create(NAME, {"notes.txt": b"mine", "data/extra.parquet": b"\0" * 9, ".gitattributes": b"*"})
    prepared = Upload.of_folder(str(folder), NAME)
    assert prepared.plan.kept == ("data/extra.parquet", "notes.txt")
    assert prepared.plan.removed == ()
    prepared.send()
    assert {"notes.txt", "data/extra.parquet"} <= set(server.repository(NAME).head.files)
    assert_holds(server, folder)
    result = upload(folder, delete=True)
    assert (result.sent, result.removed) == ((), ("data/extra.parquet", "notes.txt"))
    assert set(server.repository(NAME).head.files) - {".gitattributes"} == {
        f.relative_to(folder).as_posix() for f in folder.rglob("*") if f.is_file()
    }
    assert ".gitattributes" in server.repository(NAME).head.files
    assert upload(folder, delete=True).commit == result.commit


def test_brackets_in_names_delete_no_other_file(server, folder):
    server.create(NAME, {"a[12].txt": b"x", "a1.txt": b"x"})
    upload(folder)
    prepared = Upload.of_folder(str(folder), NAME, UploadOptions(delete=True))
    assert prepared.plan.removed == ("a1.txt", "a[12].txt")
    prepared.send()
    assert not {"a[12].txt", "a1.txt"} & set(server.repository(NAME).head.files)


def test_a_lost_answer_makes_no_second_commit(server, folder):
    server.faults.lose_reply("*/commit/*")
    upload(folder)
    assert_holds(server, folder)
    assert len(server.repository(NAME).history) == 2
    assert [request.path for request in server.requests if "/commit/" in request.path] == [
        f"/api/datasets/{NAME}/commit/main"
    ]


@pytest.mark.parametrize("pattern", ["*/repos/create", "*/commit/*", "*/tag/*"])
def test_transient_failures_are_retried(server, folder, pattern):
    told: list[str] = []
    server.faults.fail(pattern, 503, times=2)
    Upload.of_folder(str(folder), NAME, UploadOptions(tag="v1"), on_wait=told.append).send()
    assert_holds(server, folder)
    assert server.repository(NAME).tags == {"v1": server.repository(NAME).head.sha}
    assert len(server.repository(NAME).history) == 2
    assert ["503" in line and "trying again in 0.0" in line for line in told] == [True, True]


def test_damage_in_transit_is_found(server, folder, monkeypatch):
    from tests.hub_server import writing

    honest = writing._change

    def careless(repository, base, line):
        path, blob = honest(repository, base, line)
        if path == "manifest.json":
            return path, type(blob)(blob.content.replace(b"train", b"trian"), is_lfs=False)
        return path, blob

    monkeypatch.setattr(writing, "_change", careless)
    with pytest.raises(IntegrityError, match=r"does not hold what was sent .*manifest.json differs"):
        upload(folder, tag="v1")
    assert server.repository(NAME).tags == {}, "what is damaged gets no name"
    monkeypatch.setattr(writing, "_change", honest)
    assert upload(folder).sent == ("manifest.json",)


def test_a_branch_is_made_and_main_stays(server, folder):
    result = upload(folder, revision="next", tag="v2")
    repository = server.repository(NAME)
    assert repository.branches["next"] == result.commit
    assert repository.head.title == "initial commit"
    assert repository.tags == {"v2": result.commit}
    assert_holds(server, folder, revision="next")
    assert upload(folder, revision="next").sent == ()
    assert upload(folder, revision="next", tag="v2").options.tag is None


def test_a_new_branch_is_compared_with_where_it_starts(server, folder, capfd):
    first = upload(folder)
    server.requests.clear()
    result = upload(folder, revision="same")
    assert (result.sent, result.commit) == ((), first.commit)
    assert server.repository(NAME).branches["same"] == first.commit
    assert [r.path for r in server.requests if r.method == "POST"] == [f"/api/datasets/{NAME}/branch/same"]
    with (folder / "README.md").open("a") as card:
        card.write("\nMore.\n")
    prepared = Upload.of_folder(str(folder), NAME, UploadOptions(revision="more"))
    assert [file.path for file in prepared.plan.to_send] == ["README.md"]
    assert prepared.send().sent == ("README.md",)
    assert server.repository(NAME).head.sha == first.commit
    assert capfd.readouterr().err == "", "the client library spoke for itself"


@pytest.mark.parametrize("name", ["stars", "someone/", "a/b/c", "", "someone/my stars", "https://a.b/c/d"])
def test_invalid_names_are_refused_before_any_request(server, folder, name):
    with pytest.raises(InputError, match="is not a name of a repository; next: give USER/NAME"):
        upload(folder, name)
    assert server.requests == []
    assert server.repositories == {}


def test_a_folder_without_its_card_is_not_sent(server, folder):
    (folder / "README.md").unlink()
    with pytest.raises(
        IntegrityError,
        match=r"README\.md: is missing; next: run the command that made it again, or the command `card`",
    ) as refused:
        upload(folder)
    assert str(refused.value).count("next: ") == 1


def test_a_pull_request_is_opened_and_followed(server, folder):
    upload(folder)
    with (folder / "README.md").open("a") as card:
        card.write("\nBetter words.\n")
    first = upload(folder, create_pr=True)
    assert (first.pull, first.sent, first.options.tag) == ("refs/pr/1", ("README.md",), None)
    assert b"Better" not in server.repository(NAME).head.files["README.md"].content
    followed = upload(folder, revision="refs/pr/1")
    assert (followed.commit, followed.sent) == (first.commit, ())


def test_names_move_only_where_they_may(server, folder):
    upload(folder, tag="v1")
    with (folder / "README.md").open("a") as card:
        card.write("\nMore.\n")
    with pytest.raises(
        InputError, match=r"tag 'v1' of .* names commit \w{12} already; nothing was sent; next:"
    ):
        upload(folder, tag="v1")
    assert len(server.repository(NAME).history) == 2
    second = upload(folder, tag="v2", message="With more")
    tags = server.repository(NAME).tags
    assert tags["v2"] == second.commit != tags["v1"]
    assert server.repository(NAME).head.title == "With more"
    del tags["v2"]
    assert upload(folder, tag="v2").options.tag == "v2", "a name that a killed upload had not set is set"


@pytest.mark.parametrize("other", [{"revision": "next"}, {"tag": "v1"}])
def test_a_pull_request_excludes_contradicting_options(other):
    with pytest.raises(InputError, match="exclude each other"):
        UploadOptions(create_pr=True, **other)
    assert UploadOptions(create_pr=True, revision="main").create_pr


def test_private_is_private(server, folder):
    upload(folder, private=True)
    assert server.repository(NAME).private
    assert upload(folder, private=True).sent == ()
    server.create("someone/open")
    with pytest.raises(InputError, match="everyone can see it, but --private was given; nothing was sent"):
        upload(folder, "someone/open", private=True)
    prepared = Upload.of_folder(str(folder), "someone/late", UploadOptions(private=True))
    server.create("someone/late")
    with pytest.raises(InputError, match="everyone can see it"):
        prepared.send()
    assert server.repository("someone/late").head.title == "initial commit"


def test_damaged_data_sets_are_not_sent(server, folder):
    shard = folder / "data" / "test-00000-of-00001.parquet"
    content = bytearray(shard.read_bytes())
    content[1000] ^= 1
    shard.write_bytes(content)
    with pytest.raises(
        IntegrityError,
        match=r"nothing was uploaded, because the folder has problems: data/test-00000.* sha256 is",
    ):
        upload(folder)
    content[1000] ^= 1
    shard.write_bytes(content)
    card = folder / "README.md"
    card.write_text(card.read_text().replace("num_examples: 9", "num_examples: 8"))
    with pytest.raises(IntegrityError, match="num_examples of split 'test' is 8, expected 9"):
        upload(folder)
    assert server.requests == []


def test_folders_without_a_data_set_are_refused(server, tmp_path):
    with pytest.raises(InputError, match=r"no manifest.json in .*; next:"):
        Upload.of_folder(str(tmp_path), NAME)
    with pytest.raises(InputError, match=r"no manifest.json in 'memory://somewhere'.*; next:"):
        Upload.of_folder("memory://somewhere", NAME)
    assert server.requests == []


def test_a_folder_in_a_store_is_sent_from_a_copy_that_goes_with_the_upload(server, folder):
    """Hidden files are left out; a name that leads elsewhere or a failure of the store ends the upload."""
    store = open_folder("memory://uploads/stars")
    for path, content in folder_bytes(folder).items():
        store.write_bytes(path, content)
    store.write_bytes(".hidden", b"mine")
    prepared = Upload.of_folder("memory://uploads/stars", NAME)
    copy = next(each.local_path for each in prepared.files if each.path.startswith("data/")).parents[1]
    assert folder_bytes(copy) == folder_bytes(folder)
    prepared.send()
    assert_holds(server, folder)
    del prepared
    assert not copy.exists()


UPLOAD = """
from tactile_toolkit.exchange.upload import Upload
Upload.of_folder({folder!r}, {name!r}).send()
"""


def test_a_killed_upload_continues_with_the_missing_files(server, folder, tmp_path):
    """The process is killed while one large file is sent; the next process sends only this file."""
    wanted = {*shards_of(folder).values(), _sha256(folder / "previews" / "scenes.png")}
    late = shards_of(folder)["data/train-00001-of-00003.parquet"]
    server.faults.fail(f"/lfs/*/{late}", 503, times=10_000)
    token = next(iter(server.accounts))
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    environment = settings(server, tmp_path, token, TMPDIR=str(scratch))
    before = folder_bytes(folder)
    process = start_here(UPLOAD.format(folder=str(folder), name=NAME), environment, tmp_path)
    while not _has_all_but(server, wanted - {late}, late):
        assert process.is_running, process.err
        time.sleep(0.01)
    assert process.end(signal.SIGKILL) == -signal.SIGKILL
    assert set(server.repository(NAME).objects) == wanted - {late}
    assert server.repository(NAME).head.title == "initial commit"
    left = {file.name for file in scratch.rglob("*") if file.is_file()}
    assert left <= {"README.md", "manifest.json"}, "which go with the next upload"
    assert folder_bytes(folder) == before
    server.faults.clear()
    server.requests.clear()
    upload(folder)
    assert sent_objects(server) == [late]
    assert_holds(server, folder)
    assert len(server.repository(NAME).history) == 2


def _has_all_but(server: HubServer, arrived: set[str], late: str) -> bool:
    found = server.find("datasets", NAME)
    return found is not None and set(found.objects) == arrived and late in sent_objects(server)
