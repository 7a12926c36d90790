"""Classes, rounds and splits of imported touches keep any names; columns are mapped."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

import realtouch
from tactile_toolkit.errors import InputError
from tests.command_line import call
from tests.realtouch.images_of_others import line, picture, write_table, write_tar


@pytest.mark.parametrize("layout", ["png", "webdataset", "replay"])
def test_names_of_our_own_exports_stay(layout: Any, home: Path, tmp_path: Path) -> None:
    """Also for a data set without poses and positions."""
    names, ids = ["zebra", "ant", "cat"], ["a.b", "c/d", "ü, e"]
    lines = [
        line(f"pictures/{number}.jpg", names[number % 3]) | {"object_id": "7", "round_id": ids[number % 3]}
        for number in range(4)
    ]
    write_table(home, lines)
    realtouch.import_touches(home, tmp_path / "named", realtouch.ImportSpec("folder", classes=names))
    exported = ("export", tmp_path / "named", "--split", "train", "--format", layout)
    assert call("tactile", *exported, "--out", tmp_path / "there") == 0
    assert not realtouch.import_touches(tmp_path / "there", tmp_path / "back").skipped_reasons()
    there, back = (realtouch.load(tmp_path / name, "train") for name in ("named", "back"))
    assert list(back.label_names) == names
    assert back.ids.tolist() == there.ids.tolist() == ids
    assert back.labels.tolist() == there.labels.tolist()


@pytest.mark.parametrize(
    ("labels", "names"),
    [
        (["007", "7", "01", "1"], ["007", "01", "1", "7"]),
        (["1.0", "1.5", "2.0", "1.0"], ["1.0", "1.5", "2.0"]),
        (["zebra", "ant", "3", "3.0"], ["3", "3.0", "ant", "zebra"]),
        (["3.0", "3", "0", "12"], [str(number) for number in range(13)]),
        (["10000", "9", "9", "9"], ["10000", "9"]),
    ],
)
def test_classes_stay_the_text_that_they_are(labels, names, home, tmp_path):
    write_table(home, [line(f"pictures/{number}.jpg", label) for number, label in enumerate(labels)])
    manifest = realtouch.import_touches(home, tmp_path / "out", realtouch.ImportSpec("folder"))
    found = realtouch.load(tmp_path / "out", "train")
    assert list(found.label_names) == names
    stored = [found.label_names[label] for label in found.labels]
    assert stored == [label if label in names else label.removesuffix(".0") for label in labels]
    assert not manifest.skipped_reasons()


def test_text_that_cannot_be_stored_or_seen(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Lone surrogates are left out; characters that turn or hide text reach no terminal, manifest or card."""
    fields = [
        {"label": "a\u202eb\x07\u0085x", "round": "r\u202e\x1b[31m", "cap\ud800": 1},
        {"label": "\ud800x", "round": "b"},
        {"label": "ok", "round": "c\udfff"},
        {"label": "ok", "round": "d"},
        {"label": "ok", "round": "e"},
    ]
    names = ("a", "b", "c", "d", "e\u2067")
    members = [
        (f"{name}.{ending}", content)
        for name, values in zip(names, fields, strict=True)
        for ending, content in (("jpg", picture(9)), ("json", json.dumps(values).encode()))
    ]
    write_tar(tmp_path / "a.tar", members)
    out = tmp_path / "out"
    arguments = ("import", tmp_path / "a.tar", "--format", "webdataset", "--workers", 1, "--max-left-out", 1)
    assert call("realtouch", *arguments, "--map", "round=round", "--out", out) == 0
    for command in ("verify", "info", "card"):
        assert call("tactile", command, out) == 0
    found = realtouch.load(out, "train")
    assert (found.label_names, found.ids.tolist()) == (
        ("a\u202eb\x07\u0085x", "ok"),
        ["r\u202e\x1b[31m", "d"],
    )
    said = capsys.readouterr()
    shown = {"out": said.out, "err": said.err}
    shown |= {path.name: path.read_text() for path in out.iterdir() if path.is_file()}
    for name, text in shown.items():
        assert text.replace("\n", "").isprintable(), name
    assert "left out: 'b': its field 'label' holds text that is not Unicode (json)" in said.err
    reasons = json.loads(shown["manifest.json"])["skipped"]
    assert reasons == {"json": 2, "name": 1}
    assert call("realtouch", *arguments, "--classes", "ok,\udcff", "--out", tmp_path / "no") == 2
    assert "is not valid UTF-8; next: give another name" in capsys.readouterr().err
    assert not (tmp_path / "no").exists()


def test_stored_text_that_is_not_unicode(single_folder, tmp_path, capsys):
    realtouch.select(single_folder, tmp_path / "out", split="test")
    (shard,) = (tmp_path / "out" / "data").iterdir()
    manifest, good = tmp_path / "out" / "manifest.json", (tmp_path / "out" / "manifest.json").read_text()
    for escape in ("\\ud800", "\\uDFFF"):
        manifest.write_text(good.replace('"select"', f'"select{escape}"'))  # damaged, whatever its digest
        for command in ("verify", "info", "card"):
            assert call("tactile", command, tmp_path / "out") == 3, command
            assert "surrogate" in capsys.readouterr().err
    manifest.unlink()
    table = pq.read_table(shard)
    metadata = table.schema.metadata[b"huggingface"].replace(b'"0"', b'"\\ud800"')
    pq.write_table(table.replace_schema_metadata({b"huggingface": metadata}), shard)
    for command in ("verify", "info", "card"):
        assert call("tactile", command, tmp_path / "out") == 3, command
        assert "class names among them" in capsys.readouterr().err


def test_mapped_names(tmp_path: Path) -> None:
    lines = tmp_path / "columns.txt"
    lines.write_text("# of the glove\nround = session \n\nforce_n=Fz\n")
    found = realtouch.ImportColumns(length_unit="mm").with_mapped(
        ["label=class", "pose=x, y,z,qx,qy,qz,qw", f"@{lines}", "object=", "a=b=c", "temperature="]
    )
    assert (found.label, found.round, found.object_id, found.length_unit) == ("class", "session", "", "mm")
    assert found.pose == ("x", "y", "z", "qx", "qy", "qz", "qw")
    assert found.extra == (("force_n", "Fz"), ("a", "b=c"), ("temperature", ""))
    assert found.names() == ["class", "session", *found.pose, "Fz", "b=c"]


@pytest.mark.parametrize(
    ("pairs", "words"),
    [
        (["label"], "mapped has 'label'; expected NAME=COLUMN"),
        (["=x"], "expected NAME=COLUMN"),
        (["lable=x"], "'lable'; expected one of image, .*did you mean 'label'"),
        (["object_id=x"], "did you mean 'object'"),
        (["label=x", "label=y"], "names 'label' twice"),
        (["@nothing.txt"], "cannot be read"),
        (["a\tb=x"], "printable characters"),
        (["pose=x,y,z"], "3 pose columns"),
    ],
)
def test_mapped_names_that_cannot_be_used(pairs: list[str], words: str) -> None:
    with pytest.raises(InputError, match=words):
        realtouch.ImportColumns().with_mapped(pairs)
