from __future__ import annotations

import json
from pathlib import Path

import pytest

from tactile_toolkit.wording import with_count
from tests.command_line import call
from tests.realtouch import factories
from tests.tactile_toolkit.toy import folder_bytes

DIGITS = ("--split", "test", "--per-class", "1", "--vertices", "2000", "--workers", "1", "--quiet")


@pytest.fixture(scope="module")
def folders(tmp_path_factory) -> dict[str, Path]:
    base = tmp_path_factory.mktemp("cli")
    assert call("mnist3d", "generate", *DIGITS, "--out", base / "mnist3d") == 0
    stars = ("--split", "test", "--scenes", "6", "--workers", "1", "--quiet")
    assert call("starstruck", "generate", *stars, "--out", base / "starstruck") == 0
    rows = factories.seq_rows([factories.make_round(0, 3, (48, 36))])
    factories.write_set(base / "realtouch", {"train": rows}, "seq")
    return {name: base / name for name in ("mnist3d", "starstruck", "realtouch")}


ITEMS = {"mnist3d": (10, "digits"), "starstruck": (6, "scenes"), "realtouch": (1, "rounds")}


@pytest.mark.thorough
@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("program", ITEMS)
def test_gallery_says_what_was_made_and_what_next(program, folders, tmp_path, capsys):
    count, nouns = ITEMS[program]
    out = tmp_path / "site"
    assert call(program, "gallery", folders[program], "--out", out, "--workers", 1) == 0
    printed = capsys.readouterr()
    assert f": {with_count(count, nouns)}, " in printed.out
    assert f"next: open {out / 'index.html'} in a browser" in printed.out
    assert f"making the gallery: {count} of {count}" in printed.err
    assert (out / "index.html").is_file()


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("program", ITEMS)
def test_dry_run_counts_the_items_of_each_split_and_writes_nothing(program, folders, tmp_path, capsys):
    out = tmp_path / "site"
    arguments = ("gallery", folders[program], "--out", out, "--workers", 1)
    assert call(program, *arguments, "--dry-run", "--json") == 0
    view = json.loads(capsys.readouterr().out)
    assert not out.exists()
    assert call(program, *arguments, "--dry-run") == 0
    assert f"would make {out}: {with_count(*ITEMS[program])}; nothing was written" in capsys.readouterr().out
    assert call(program, *arguments, "--json", "--quiet") == 0
    printed = capsys.readouterr()
    made = json.loads(printed.out)
    assert printed.err == ""
    files = folder_bytes(out)
    assert (made["files"], made["bytes"]) == (len(files), sum(map(len, files.values())))
    assert (view["path"], view["items"], view["splits"]) == (str(out), made["items"], made["splits"])
    assert made["page"] == str(out / "index.html")
    assert call(program, *arguments, "--dry-run") == 2
    assert "holds a gallery already" in capsys.readouterr().err
    assert call(program, *arguments, "--dry-run", "--overwrite") == 0
    assert f"would replace the gallery in {out}" in capsys.readouterr().out
    assert folder_bytes(out) == files


def test_refusals_and_overwrite(folders, tmp_path, capsys):
    out = tmp_path / "site"
    arguments = ("starstruck", "gallery", folders["starstruck"], "--out", out, "--quiet", "--workers", "1")
    assert call(*arguments) == 0
    before = folder_bytes(out)
    assert call(*arguments) == 2
    assert "holds a gallery already" in capsys.readouterr().err
    assert call(*arguments, "--overwrite") == 0
    assert folder_bytes(out) == before
    assert (
        call("starstruck", "gallery", folders["starstruck"], "--out", folders["mnist3d"], "--overwrite") == 2
    )
    assert "is not part of a gallery or was changed since; nothing was changed" in capsys.readouterr().err
    assert call("mnist3d", "gallery", tmp_path / "absent", "--out", tmp_path / "new") == 2
    assert call("mnist3d", "gallery", folders["realtouch"], "--out", tmp_path / "new") == 2
    assert "holds touches; `mnist3d gallery` is for digits; next: run `realtouch " in capsys.readouterr().err
    for program, other in (("mnist3d", "starstruck"), ("starstruck", "mnist3d")):
        assert call(program, "gallery", folders[other], "--out", tmp_path / "new") == 2
        assert f"next: run `{other} gallery " in capsys.readouterr().err
    assert call("mnist3d", "gallery", folders["mnist3d"], "--out", "s3://bucket/site") == 2
    assert "is a remote address" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()
