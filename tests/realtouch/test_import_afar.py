"""Import of images from an object store."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import realtouch
from tactile_toolkit.errors import InputError
from tactile_toolkit.store import open_folder
from tests.tactile_toolkit.toy import folder_bytes

pytestmark = pytest.mark.s3
pytest.importorskip("s3fs")
pytest.importorskip("moto")


COLUMNS = realtouch.ImportColumns(round="round_id", object_id="object_id", split="split")


def lists(server: Any) -> list[str]:
    """Return the requested listings of buckets, without requests for objects."""
    return [path for path in server.traffic.paths if path.startswith("GET") and path.count("/") < 3]


@pytest.mark.parametrize("layout", ["folder", "webdataset"])
def test_imports_from_a_store_equal_those_from_a_folder(layout, single_folder, tmp_path, s3, bucket):
    columns = COLUMNS
    if layout == "folder":
        realtouch.export(single_folder, tmp_path / "there", "jpeg")
        (tmp_path / "there" / "images" / "train").rename(tmp_path / "there" / "images" / "moved")
        index = (tmp_path / "there" / "index.csv").read_text().replace("images/train/", "images/moved/", 3)
        (tmp_path / "there" / "index.csv").write_text(index.replace("images/train/", "./images/moved/"))
        next((tmp_path / "there" / "images" / "moved").rglob("002.jpg")).unlink()
        home = tmp_path / "there"
    else:
        realtouch.export(single_folder, tmp_path / "there", "webdataset", split="train")
        home, columns = tmp_path / "there" / "webdataset", realtouch.ImportColumns(round="round_id")
    afar = open_folder(f"s3://{bucket}/of others")
    for path in folder_bytes(home):
        afar.upload(path, home / path)
    s3.traffic.reset()
    made = realtouch.import_touches(afar.root, tmp_path / "afar", realtouch.ImportSpec(layout, columns))
    folders = {parent for path in folder_bytes(home) for parent in Path(path).parents}
    assert len(lists(s3)) <= len(folders) + 3, "a folder is listed once"
    size = sum(len(content) for content in folder_bytes(home).values())
    assert s3.traffic.sent_bytes < 3 * size + 100_000
    skipped = [item.reason for record in made.shards for item in record.skipped]
    assert skipped == (["missing"] if layout == "folder" else [])
    realtouch.import_touches(home, tmp_path / "near", realtouch.ImportSpec(layout, columns))
    assert folder_bytes(tmp_path / "afar") == folder_bytes(tmp_path / "near")
    realtouch.import_touches(afar.root, f"s3://{bucket}/touches", realtouch.ImportSpec(layout, columns))
    assert len(realtouch.load(f"s3://{bucket}/touches", "train")) == 3
    if layout == "webdataset":
        one = realtouch.import_touches(
            f"{afar.root}/train-000000.tar", tmp_path / "one", realtouch.ImportSpec(layout, columns)
        )
        assert one.split_table() == made.split_table()


def test_addresses_that_cannot_be_read(tmp_path: Path, s3: Any, bucket: str) -> None:
    open_folder(f"s3://{bucket}/images").write_bytes("a.jpg", b"no table here")
    for place, out, words in (
        (f"s3://{bucket}/nothing", tmp_path / "out", "does not exist"),
        (f"s3://{bucket}/images", tmp_path / "out", "no row is left"),
        (f"s3://{bucket}/images", f"s3://{bucket}/images/in", "lies in the source"),
        ("https://example.org/images", tmp_path / "out", "and not of the web"),
        ("s3://key@bucket/images", tmp_path / "out", "may hold a user, a key"),
    ):
        with pytest.raises(InputError, match=words):
            realtouch.import_touches(place, out, realtouch.ImportSpec("folder"))
        assert not (tmp_path / "out").exists()
