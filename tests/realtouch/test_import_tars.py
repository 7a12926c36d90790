"""Tars of other programs: samples with missing parts, and impossible headers."""

from __future__ import annotations

import io
import json
import tarfile
from pathlib import Path

import pytest
from hypothesis import assume, given, strategies as st

import realtouch
from realtouch.formats.tar_samples import tar_of
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.store import Progress
from tests.command_line import call
from tests.realtouch.images_of_others import picture, write_tar


def test_tars_of_others(tmp_path: Path) -> None:
    home = tmp_path / "tars"
    home.mkdir()
    members = []
    for number in range(3):
        fields = json.dumps({"digit": number, "pose": [0, 0, 0.1, 0, 0, 0, 1]}).encode()
        members += [(f"set/a{number}.jpg", picture(number)), (f"set/a{number}.json", fields)]
    members += [
        ("set/b.json", b"{}"),
        ("set/c.jpg", picture(1)),
        ("set/c.json", b"[1"),
        members[0],
        members[1],
    ]
    write_tar(home / "x-000.tar", members)
    write_tar(home / "x-001.tar", [("d.png", picture(5)), ("d.cls", b"2"), ("d.json", b'{"digit": 2}')])
    columns = realtouch.ImportColumns(image=None, label="digit", pose=("pose",))
    manifest = realtouch.import_touches(
        home, tmp_path / "out", realtouch.ImportSpec("webdataset", columns, max_left_out=1)
    )
    reasons = [(item.id, item.reason) for item in manifest.shards[0].skipped]
    assert reasons == [(3, "missing"), (4, "json"), (5, "duplicate"), (6, "pose")]
    assert [record.label for record in realtouch.load(tmp_path / "out", "train")] == [0, 1, 2]
    as_json = [json.dumps({"label": value}).encode() for value in (float("nan"), [1], {}, None, 1)]
    odd = [(f"./{number}.rgb.jpg", picture(1)) for number in range(6)]
    odd += [(f"./{number}.json", text) for number, text in enumerate([*as_json, b" " * (1 << 21)])]
    write_tar(tmp_path / "odd.tar", sorted(odd))
    for image in (None, "rgb.jpg"):
        columns_of_odd = realtouch.ImportColumns(image=image)
        spec = realtouch.ImportSpec("webdataset", columns_of_odd, max_left_out=1)
        manifest = realtouch.import_touches(tmp_path / "odd.tar", tmp_path / f"odd-{image}", spec)
        reasons = [(item.id, item.reason) for item in manifest.shards[0].skipped]
        assert reasons == [*((number, "label") for number in range(4)), (5, "json")]
        assert "expected an object of at most 1 MiB" in manifest.shards[0].skipped[-1].message
        assert realtouch.load(tmp_path / f"odd-{image}", "train").ids.tolist() == ["4"]
    by_class = realtouch.ImportColumns(label="cls")
    realtouch.import_touches(
        home / "x-001.tar", tmp_path / "one", realtouch.ImportSpec("webdataset", by_class)
    )
    assert realtouch.load(tmp_path / "one", "train")[0].label == 2
    whole = (home / "x-000.tar").read_bytes()
    for kept in (len(whole) // 3, 10240 - 9000, 700):
        (home / "x-000.tar").write_bytes(whole[:kept])
        with pytest.raises(IntegrityError, match="not an intact tar"):
            realtouch.import_touches(home, tmp_path / "cut", realtouch.ImportSpec("webdataset", columns))
        assert not (tmp_path / "cut").exists()


def test_a_tar_that_is_replaced_before_its_images_are_read_is_refused(tmp_path: Path) -> None:
    """Otherwise images with the same names would get the labels of earlier ones."""
    fields = [(f"{number}.json", json.dumps({"label": number}).encode()) for number in range(2)]
    for name, levels in (("source.tar", (10, 90)), ("new.tar", (90, 10))):
        pictures = [(f"{number}.jpg", picture(level)) for number, level in enumerate(levels)]
        write_tar(tmp_path / name, sorted(pictures + fields))
    source, new_tar = tmp_path / "source.tar", tmp_path / "new.tar"
    assert source.stat().st_size == new_tar.stat().st_size

    def exchange(_progress: Progress) -> None:
        new_tar.replace(source)

    with pytest.raises(IntegrityError, match=r"source\.tar' was replaced"):
        realtouch.import_touches(
            source, tmp_path / "out", realtouch.ImportSpec("webdataset"), on_progress=exchange
        )
    assert not (tmp_path / "out").exists()


def pax(**fields: str) -> tuple[tarfile.TarInfo, bytes]:
    content = b""
    for name, value in fields.items():
        record = f" {name.replace('_', '.')}={value}\n"
        length = next(n for n in range(len(record), len(record) + 9) if len(f"{n}{record}") == n)
        content += f"{length}{record}".encode()
    entry = tarfile.TarInfo("././@PaxHeader")
    entry.type, entry.size = tarfile.XHDTYPE, len(content)
    return entry, content


@pytest.mark.parametrize(
    ("before", "size", "words"),
    [
        ([], -1024, "'b.jpg' is sparse, or its size is not a number"),
        ([pax(size="-1536")], 0, "'b.jpg' is sparse, or its size is not a number"),
        ([pax(size="many")], 0, "'b.jpg' is sparse, or its size is not a number"),
        ([pax(GNU_sparse_size="many")], 0, "cannot be read"),
        ([pax(GNU_sparse_map="0,many")], 0, "cannot be read"),
        ([pax(GNU_sparse_major="1", GNU_sparse_minor="0")], 0, "cannot be read"),
        ([pax(GNU_sparse_size="9", GNU_sparse_offset="0")], 0, "'b.jpg' is sparse"),
        ([pax(path="c.jpg")] * 2000, 0, "cannot be read: maximum recursion"),
        ([pax(path="c" * 300, size="5" * 5000)], 0, f"'{'c' * 300}' is sparse, or its size is not a number"),
    ],
)
def test_a_tar_with_an_impossible_header(before, size, words, tmp_path, capsys):
    write_tar(tmp_path / "a.tar", [("a.jpg", picture(1)), ("a.cls", b"1")])
    last = tarfile.TarInfo("b.jpg")
    last.size = size
    odd = b"".join(
        entry.tobuf(tarfile.GNU_FORMAT) + content + bytes(-len(content) % 512)
        for entry, content in [*before, (last, b"")]
    )
    good = (tmp_path / "a.tar").read_bytes().rstrip(b"\0")
    good += bytes(-len(good) % 512)
    (tmp_path / "a.tar").write_bytes(good + odd + bytes(10_240))
    arguments = ("import", tmp_path / "a.tar", "--format", "webdataset", "--map", "label=cls")
    assert call("realtouch", *arguments, "--workers", 1, "--out", tmp_path / "out") == 3
    message = capsys.readouterr().err
    assert words in message
    assert len(message.splitlines()) == 1
    assert not (tmp_path / "out").exists()


@given(st.lists(st.tuples(st.text("abü/.", min_size=1, max_size=120), st.binary(max_size=1500)), max_size=12))
def test_tars_are_written_as_tarfile_writes_them(samples: list[tuple[str, bytes]]) -> None:
    stream = io.BytesIO()
    fields = [{"number": number, "name": "ü", "third": 1 / 3} for number in range(len(samples))]
    try:
        with tarfile.open(fileobj=stream, mode="w", format=tarfile.USTAR_FORMAT) as tar:
            for (name, content), values in zip(samples, fields, strict=True):
                text = json.dumps(values, ensure_ascii=False, separators=(",", ":")).encode()
                for member, member_bytes in ((name, content), (f"{name.partition('.')[0]}.json", text)):
                    header = tarfile.TarInfo(member)
                    header.size = len(member_bytes)
                    tar.addfile(header, io.BytesIO(member_bytes))
    except ValueError:  # a name that is too long
        assume(False)
    content_of_tar = tar_of((*sample, values) for sample, values in zip(samples, fields, strict=True))
    assert content_of_tar == stream.getvalue()


def test_long_names_are_read_by_tarfile(tmp_path: Path) -> None:
    names = [f"{'b' * 95}.jpg", f"{'c' * 96}.jpg", f"{'d' * 120}.jpg"]
    home = tmp_path / "tars"
    home.mkdir()
    (home / "x.tar").write_bytes(tar_of((name, picture(1), {"round_id": name[0]}) for name in names))
    with tarfile.open(home / "x.tar") as tar:
        assert tar.getnames()[::2] == names
    realtouch.import_touches(home, tmp_path / "out", realtouch.ImportSpec("webdataset"))
    assert [record.id for record in realtouch.load(tmp_path / "out", "train")] == ["b", "c", "d"]
