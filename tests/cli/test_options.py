from __future__ import annotations

from pathlib import Path

import pytest
import typer

from cli.options import local_place


def test_places_to_write_are_local_and_the_home_folder_is_known(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert local_place("~/pictures") == tmp_path / "pictures"
    assert local_place("a//b") == Path("a/b")
    assert local_place(Path("gallery")) == Path("gallery")
    for address in ("s3://bucket/site", "memory://site", "file:///tmp/site"):
        with pytest.raises(typer.BadParameter, match="is a remote address; expected a local path"):
            local_place(address)


def test_the_home_of_nobody_is_refused():
    with pytest.raises(typer.BadParameter, match="no home folder is known"):
        local_place("~nobody-of-that-name/x")
