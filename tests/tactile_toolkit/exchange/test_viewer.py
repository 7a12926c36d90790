"""Meshes on the page of the Hub: a second configuration, which `datasets` reads and our loaders ignore."""

from __future__ import annotations

import json
from pathlib import Path

import datasets
import pytest
import yaml

import mnist3d
from mnist3d.digit_generation import DigitSetSpec, generate
from mnist3d.sources.synthetic import SyntheticSource
from tactile_toolkit import cards
from tactile_toolkit.cards.yaml_head import check_card
from tactile_toolkit.exchange import Upload, UploadOptions
from tactile_toolkit.store import open_folder
from tests.hub_server import HubServer, hub
from tests.tactile_toolkit.exchange.upload_client import logged_in
from tests.tactile_toolkit.hub.client import run_here, settings, start_here
from tests.tactile_toolkit.toy import folder_bytes

NAME = "someone/digits"
SPLITS = ("test", "holdout")

pytestmark = pytest.mark.filterwarnings(
    "ignore:Use 'content=<...>':DeprecationWarning"  # made by the client, in every PUT
)


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """Digits with default settings, so that their size is that of users."""
    folder = tmp_path_factory.mktemp("viewer") / "digits"
    generate(DigitSetSpec(SyntheticSource(), per_class=1), str(folder), SPLITS)
    return folder


def upload(folder: Path, **options: object):
    return Upload.of_folder(str(folder), NAME, UploadOptions(**options)).send()  # type: ignore[arg-type]


def held(server: HubServer) -> dict[str, bytes]:
    return {path: blob.content for path, blob in server.repository(NAME).head.files.items()}


@pytest.fixture(scope="module")
def sent(made) -> dict[str, bytes]:
    """The content of the Hub after an upload with meshes in 3D."""
    with pytest.MonkeyPatch.context() as patch, hub() as server:
        with logged_in(server, server.account("someone"), patch):
            upload(made, viewer=True)
        return held(server)


LOAD = """
import datasets, json, mnist3d
shown = datasets.load_dataset("someone/digits", "viewer", split="test")
fast = datasets.load_dataset("someone/digits", split="test")
digits = mnist3d.load("someone/digits", "test")
print("REPORT" + json.dumps({
    "kind": str(shown.features["mesh"]),
    "columns": shown.column_names,
    "fast": fast.column_names,
    "ids": [shown["id"] == fast["id"] == [digit.id for digit in digits]],
    "volumes": [[row["mesh"].to_mesh().volume, digit.mesh.volume] for row, digit in zip(shown, digits)],
    "watertight": all(row["mesh"].to_mesh().is_watertight for row in shown),
}))
"""


@pytest.mark.thorough
@pytest.mark.skipif(not hasattr(datasets, "Mesh"), reason="this release of datasets knows no meshes")
def test_each_row_is_shown_in_3d_and_the_fast_columns_stay_the_default(server, made, tmp_path):
    before = folder_bytes(made)
    first = upload(made, viewer=True)
    assert folder_bytes(made) == before, "the folder itself is left as it is"
    files = held(server)
    shown = sorted(path for path in files if path.startswith("viewer/"))
    assert shown == [f"viewer/{split}-00000-of-00001.parquet" for split in sorted(SPLITS)]
    assert set(shown) <= set(first.sent)
    rows = 10 * len(SPLITS)
    both = sum(len(files[path]) for path in files if path.startswith(("viewer/", "data/")))
    assert both / rows < 115_000
    head = yaml.safe_load(files["README.md"].decode().split("---\n")[1])
    assert [config["config_name"] for config in head["configs"]] == ["default", "viewer"]
    # `datasets` reads its settings when it is imported.
    done = start_here(LOAD, settings(server, tmp_path), tmp_path)
    assert done.end() == 0, done.err
    report = json.loads(next(line for line in done.out.splitlines() if line.startswith("REPORT"))[6:])
    assert report["kind"] == "Mesh(decode=True)"
    assert report["columns"] == [
        *("id", "label", "label_name", "writer", "volume_m3", "source"),
        *("size_x_m", "size_y_m", "size_z_m", "mesh"),
    ]
    assert "mesh.vertices" in report["fast"]
    assert report["ids"] == [True]
    assert report["watertight"]
    for found, expected in report["volumes"]:
        assert found == pytest.approx(expected, rel=1e-9)
    again = upload(made, viewer=True)
    assert again.sent == (), "the same rows give the same files"


@pytest.mark.thorough
def test_a_copy_of_the_repository_is_whole_with_and_without_it(sent, made, tmp_path):
    for path, content in sent.items():
        (tmp_path / "copy" / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "copy" / path).write_bytes(content)
    copy = open_folder(str(tmp_path / "copy"))
    assert cards.verify(copy).findings == ()
    assert mnist3d.load(str(tmp_path / "copy"), split="test").ids.tolist()
    (tmp_path / "copy" / "viewer" / "test-00000-of-00001.parquet").unlink()
    assert cards.verify(copy).ok, "rows are whole without it"
    shown = tmp_path / "copy" / "viewer" / "holdout-00000-of-00001.parquet"
    shown.write_bytes(shown.read_bytes()[:-1])
    (finding,) = cards.verify(copy).findings
    assert finding.file == "viewer/holdout-00000-of-00001.parquet"
    text = (tmp_path / "copy" / "README.md").read_text()
    (tmp_path / "copy" / "README.md").write_text(text.replace("viewer/test-*", "viewer/*"))
    words = "files of split 'test' in configuration 'viewer' is ['viewer/holdout-"
    assert any(words in each.problem for each in check_card(copy))


DOWNLOAD = """
from tactile_toolkit.exchange.download import DownloadPlan
plan = DownloadPlan.of("someone/digits", {splits}, out={out!r})
plan.run()
again = DownloadPlan.of("someone/digits", {splits}, out={out!r})
print(len([file for path in plan.record.files if path.startswith("viewer/")]), again.is_done)
"""


@pytest.mark.thorough
def test_a_download_leaves_it_out(server, sent, made, tmp_path):
    server.create(NAME, sent)
    out = tmp_path / "whole"
    done = run_here(DOWNLOAD.format(splits=(), out=str(out)), settings(server, tmp_path), tmp_path)
    assert done.stdout.split() == ["0", "True"], done.stdout + done.stderr
    assert cards.verify(open_folder(str(out))).findings == ()
    whole = folder_bytes(out)
    del whole[".download.json"]
    expected = folder_bytes(made)
    expected["README.md"] = expected["README.md"].replace(b'"FOLDER"', f'"{NAME}"'.encode())
    assert whole == expected, "what is left is the folder that was sent"
    part = tmp_path / "part"
    done = run_here(DOWNLOAD.format(splits=("test",), out=str(part)), settings(server, tmp_path), tmp_path)
    assert done.stdout.split() == ["0", "True"], done.stdout + done.stderr
    assert cards.verify(open_folder(str(part))).findings == ()
    assert "viewer" not in (part / "README.md").read_text().split("---\n")[1]


@pytest.mark.thorough
def test_an_upload_without_it_takes_it_back(server, sent, made):
    repository = server.create(NAME, sent)
    repository.commit({"viewer/notes.md": repository.blob("viewer/notes.md", b"of somebody")}, "notes")
    without = upload(made)
    assert without.removed == tuple(f"viewer/{split}-00000-of-00001.parquet" for split in sorted(SPLITS))
    assert [path for path in held(server) if path.startswith("viewer/")] == ["viewer/notes.md"]
    assert upload(made).sent == ()
    head = yaml.safe_load(held(server)["README.md"].decode().split("---\n")[1])
    assert [config["config_name"] for config in head["configs"]] == ["default"]
