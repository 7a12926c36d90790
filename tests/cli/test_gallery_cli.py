from __future__ import annotations

import json
from pathlib import Path

import pytest

from tactile_toolkit.wording import with_count
from tests.command_line import call
from tests.realtouch import factories
from tests.tactile_toolkit.toy import folder_bytes

ITEMS = {"mnist3d": (20, "digits"), "starstruck": (39, "scenes"), "realtouch": (1, "rounds")}


@pytest.fixture
def folders(digits_set, scenes_set, tmp_path) -> dict[str, Path]:
    rows = factories.seq_rows([factories.make_round(0, 3, (48, 36))])
    touches = factories.write_set(tmp_path / "touches", {"train": rows}, "seq")
    return {"mnist3d": digits_set, "starstruck": scenes_set, "realtouch": touches}


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("program", ["realtouch", "mnist3d", "starstruck"])
def test_a_gallery_agrees_with_its_dry_run_and_is_replaced_on_request(program, folders, tmp_path, capsys):
    count, nouns = ITEMS[program]
    out = tmp_path / "site"
    arguments = ("gallery", folders[program], "--out", out, "--workers", 1)
    assert call("tactile", *arguments, "--dry-run", "--json") == 0
    view = json.loads(capsys.readouterr().out)
    assert call("tactile", *arguments, "--dry-run") == 0
    said = f"would make {out}: {with_count(count, nouns)}; nothing was written"
    assert said in capsys.readouterr().out
    assert not out.exists()
    assert call("tactile", *arguments, "--json", "--quiet") == 0
    printed = capsys.readouterr()
    made = json.loads(printed.out)
    assert printed.err == ""
    files = folder_bytes(out)
    assert (made["files"], made["bytes"]) == (len(files), sum(map(len, files.values())))
    assert (view["path"], view["items"], view["splits"]) == (str(out), made["items"], made["splits"])
    assert made["page"] == str(out / "index.html")
    for words in ((), ("--dry-run",)):
        assert call("tactile", *arguments, *words) == 2
        assert "holds a gallery already" in capsys.readouterr().err
    assert call("tactile", *arguments, "--dry-run", "--overwrite") == 0
    assert f"would replace the gallery in {out}" in capsys.readouterr().out
    assert call("tactile", *arguments, "--overwrite") == 0
    printed = capsys.readouterr()
    assert f": {with_count(count, nouns)}, " in printed.out
    assert f"next: open {out / 'index.html'} in a browser" in printed.out
    assert f"making the gallery: {count} of {count}" in printed.err
    assert folder_bytes(out) == files


def test_a_gallery_replaces_no_data_set_and_is_written_nowhere_else(folders, capsys):
    arguments = ("gallery", folders["realtouch"], "--overwrite", "--quiet", "--workers", 1)
    assert call("tactile", *arguments, "--out", folders["realtouch"]) == 2
    assert "is not part of a gallery or was changed since; nothing was changed" in capsys.readouterr().err
    assert call("tactile", *arguments, "--out", "s3://bucket/site") == 2
    assert "is a remote address" in capsys.readouterr().err
