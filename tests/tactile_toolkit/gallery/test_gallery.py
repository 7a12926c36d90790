from __future__ import annotations

import hashlib
import re
import signal
import time
from pathlib import Path

import pytest

from tactile_toolkit.errors import InputError, IntegrityError, ItemError, StorageError
from tactile_toolkit.gallery import Gallery, site as site_module
from tactile_toolkit.gallery.site import ASSETS, MAX_ITEMS, PAGE_FILE, THREE, asset
from tactile_toolkit.run.runners import InlineRunner, ProcessRunner
from tests.forked import run_forked, start_forked
from tests.gallery_files import files_of, index_of
from tests.gallery_toy import HOSTILE, ToyTask, toy_gallery
from tests.tactile_toolkit.toy import folder_bytes


def entries(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


def build(out: Path, gallery: Gallery | None = None, **options: object) -> site_module.Site:
    return (gallery or toy_gallery()).write(str(out), InlineRunner(), **options)  # type: ignore[arg-type]


def test_a_site_has_the_stated_content(tmp_path):
    site = build(tmp_path / "site")
    files = folder_bytes(tmp_path / "site")
    assert (site.items, site.files, site.bytes) == (20, len(files), sum(map(len, files.values())))
    assert site.splits == {"train": 20}
    inside = files_of(tmp_path / "site")
    assert entries(tmp_path / "site") == [inside.name, PAGE_FILE]
    assert entries(inside) == ["LICENSES.txt", "assets", "items", "items.js", "page.template", "thumbs"]
    index = index_of(tmp_path / "site")
    assert index["ids"] == [str(number) for number in range(20)]
    assert index["titles"] == [f"toy {number % 10}" for number in range(20)]
    parity = index["facets"][1]
    assert [parity["values"][row[0]] for row in parity["rows"]] == ["even", "odd"] * 10
    assert index["measures"][0]["values"][:3] == [None, 3.7, 7.4]
    assert set(index["measures"][1]["values"]) == {None}
    for number in range(20):
        content = (inside / "items" / f"{number:06d}.js").read_text()
        assert content.startswith(f"gallery.receive({number},")
        assert (inside / "thumbs" / f"{number:06d}.png").read_bytes().startswith(b"\x89PNG")


def test_every_asset_named_by_the_page_is_there(tmp_path):
    build(tmp_path / "site")
    page = (tmp_path / "site" / "index.html").read_text()
    named = re.findall(r'(?:src|href)="([^"]+)"', page)
    assert [name for name in named if name != "data:," and not (tmp_path / "site" / name).is_file()] == []
    assert {Path(name).name for name in named if "/assets/" in name} == set(ASSETS)
    assert "://" not in page


def test_no_asset_of_ours_writes_html_or_reaches_out():
    for name in ASSETS:
        text = asset(name)
        assert not re.search(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\b", text), name
        assert not re.search(r"https?://|\bfetch\(|XMLHttpRequest|WebSocket|sendBeacon|@import", text), name


def test_the_viewer_comes_with_its_licence(tmp_path):
    build(tmp_path / "site")
    code = (files_of(tmp_path / "site") / "assets" / THREE).read_bytes()
    terms = (files_of(tmp_path / "site") / "LICENSES.txt").read_text()
    assert hashlib.sha256(code).hexdigest() in terms
    assert b'"140"' in code
    assert "three.js 0.140.2" in terms
    assert "three.js authors" in terms
    assert "Permission is hereby granted, free of charge" in terms
    assert "SOFTWARE IS PROVIDED" in terms


def test_no_other_foreign_code_lies_in_the_package():
    own = Path(site_module.__file__).parent
    code = [file for file in own.rglob("*") if file.suffix in (".js", ".css") and file.name != THREE]
    assert max(file.stat().st_size for file in code) < 20_000


@pytest.mark.thorough
def test_bytes_do_not_depend_on_workers(tmp_path):
    build(tmp_path / "a")
    toy_gallery().write(str(tmp_path / "b"), ProcessRunner(2))
    assert folder_bytes(tmp_path / "a") == folder_bytes(tmp_path / "b")


def test_another_folder_is_refused_even_with_overwrite(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("years of work")
    for overwrite in (False, True):
        with pytest.raises(
            InputError, match=r"'thesis.txt', which is not part of a gallery .* nothing was changed"
        ):
            build(tmp_path / "mine", overwrite=overwrite)
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="is a file; expected a folder; nothing was changed"):
        build(tmp_path / "file", overwrite=True)
    assert entries(tmp_path) == ["file", "mine"]
    assert (tmp_path / "mine" / "thesis.txt").read_text() == "years of work"


def test_a_gallery_is_replaced_only_on_request_and_without_other_files(tmp_path):
    out = tmp_path / "site"
    build(out)
    before = folder_bytes(out)
    with pytest.raises(InputError, match=r"holds a gallery already; nothing was changed.*--overwrite"):
        build(out, toy_gallery(4))
    assert folder_bytes(out) == before
    build(out, toy_gallery(4), overwrite=True)
    assert len(index_of(out)["ids"]) == 4
    assert len(entries(files_of(out) / "items")) == 4
    assert entries(out) == [files_of(out).name, PAGE_FILE]
    assert entries(tmp_path) == ["site"]


@pytest.mark.parametrize(
    "unknown",
    [
        *("notes.txt", "media", "gallery.json", "files-0123456789abcdef/mine.js", "FILES/items/mine.js"),
        *("FILES/items/000021.js", "FILES/assets/fonts/mine.woff", "FILES/assets/mine/", "files-mine"),
    ],
)
def test_files_of_others_are_kept(tmp_path, unknown):
    out = tmp_path / "site"
    build(out)
    place = out / unknown.replace("FILES", files_of(out).name)
    place.parent.mkdir(exist_ok=True)
    if unknown.endswith("/"):
        place.mkdir()
    else:
        place.write_text("mine")
    before = folder_bytes(out)
    named = place.relative_to(out).parts[0]
    with pytest.raises(InputError, match=f"{named}', which is not part of a gallery .* nothing was"):
        build(out, overwrite=True)
    assert folder_bytes(out) == before
    assert place.exists()


@pytest.mark.parametrize("changed", ["PAGE", "FILES/items.js", "FILES/page.template"])
def test_a_gallery_that_somebody_changed_is_kept(tmp_path, changed):
    out = tmp_path / "site"
    build(out)
    file = out / changed.replace("PAGE", PAGE_FILE).replace("FILES", files_of(out).name)
    file.write_text(file.read_text() + " ")
    before = folder_bytes(out)
    with pytest.raises(InputError, match="or was changed since; nothing was changed"):
        build(out, overwrite=True)
    assert folder_bytes(out) == before


UNFINISHED = ".writing-0123456789abcdef0123456789abcdef-files"


@pytest.mark.parametrize("link", ["FILES/assets/mine", "FILES", PAGE_FILE, "files-mine", ".mine", UNFINISHED])
def test_links_are_not_followed(tmp_path, link):
    out, mine = tmp_path / "site", tmp_path / "mine"
    build(out)
    place = out / link.replace("FILES", files_of(out).name)
    if place.exists():
        place.rename(mine)
    else:
        mine.mkdir()
        (mine / "thesis.txt").write_text("years of work")
    before = mine.read_bytes() if mine.is_file() else folder_bytes(mine)
    place.symlink_to(mine)
    if link == UNFINISHED:  # a link made here, and not its target
        build(out, overwrite=True)
        assert not place.is_symlink()
    else:
        with pytest.raises(InputError, match=r"', which is not part of a gallery"):
            build(out, overwrite=True)
        assert place.is_symlink()
    assert (mine.read_bytes() if mine.is_file() else folder_bytes(mine)) == before


@pytest.mark.parametrize("there", [False, True])
@pytest.mark.parametrize(
    "error", [InputError("no"), IntegrityError("damaged"), ItemError("odd", "odd"), KeyboardInterrupt()]
)
def test_a_failure_in_the_middle_leaves_things_as_they_were(tmp_path, there, error):
    out = tmp_path / "site"
    if there:
        build(out)
    before = folder_bytes(tmp_path)
    tasks = (ToyTask(0, 8), ToyTask(8, 16, error=error))
    broken = Gallery("toy", "Toys", ("toy", "toys"), (), tasks, {"train": 16})
    with pytest.raises(type(error)):
        build(out, broken, overwrite=True)
    assert folder_bytes(tmp_path) == before
    assert entries(tmp_path) == (["site"] if there else [])


KILLED = """
import sys
from tactile_toolkit.run.runners import InlineRunner
from tests.gallery_toy import ToyTask, toy_gallery
from dataclasses import replace
from pathlib import Path
gallery = toy_gallery(24)
alive = str(Path(sys.argv[1]).parent.parent / "alive")
tasks = (gallery.tasks[0], gallery.tasks[1], ToyTask(16, 24, pause_s=600, alive=alive))
replace(gallery, tasks=tasks).write(sys.argv[1], InlineRunner())
"""


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_a_killed_run_leaves_no_site_and_the_next_one_clears_up(tmp_path, how):
    out = tmp_path / "place" / "site"
    out.parent.mkdir()
    process = start_forked(KILLED, out)
    while not (tmp_path / "alive").exists():
        assert process.is_running, process.err
        time.sleep(0.01)
    assert process.end(how) != 0
    assert not (out / "index.html").exists()
    if how is signal.SIGINT:
        assert entries(out.parent) == []
    build(out)
    assert entries(out.parent) == ["site"]


FULL = """
import resource, sys
from tactile_toolkit.errors import StorageError
from tactile_toolkit.run.runners import InlineRunner
from tests.gallery_toy import toy_gallery
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
try:
    toy_gallery().write(sys.argv[1], InlineRunner())
except StorageError as error:
    print(error)
"""


def test_a_full_disk_is_named_and_leaves_no_files(tmp_path):
    assert "File too large" in run_forked(FULL, tmp_path / "site")
    assert entries(tmp_path) == []


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(StorageError, match="Not a directory"):
        build(tmp_path / "file" / "site")
    with pytest.raises(InputError, match="is not a local folder; nothing was changed"):
        toy_gallery().write("memory://site", InlineRunner())


def test_empty_and_too_large_galleries_are_refused(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="there is no toy to show"):
        build(tmp_path / "site", toy_gallery(0))
    with pytest.raises(
        InputError, match=r"would show 20,001 toys; expected at most 20,000; nothing was written"
    ):
        build(tmp_path / "site", toy_gallery(MAX_ITEMS + 1, portion=MAX_ITEMS + 1))
    monkeypatch.setattr(site_module, "MAX_BYTES", len(asset(THREE)) + 3_100_000)
    made: list[int] = []
    with pytest.raises(
        InputError,
        match=r"would take more than .* GB with 56 of 80 toys; what was written is removed; next: choose",
    ):
        build(
            tmp_path / "site",
            toy_gallery(80, bulk_bytes=60_000),
            on_progress=lambda done, _total: made.append(done),
        )
    assert max(made) == 48
    assert entries(tmp_path) == []


def test_hostile_words_are_harmless_in_every_file(tmp_path):
    build(tmp_path / "site", toy_gallery(4, hostile=True))
    page = (tmp_path / "site" / "index.html").read_text()
    assert HOSTILE not in page
    assert "<script>document" not in page
    assert "onerror=&quot;" in page
    for script in [
        files_of(tmp_path / "site") / "items.js",
        *(files_of(tmp_path / "site") / "items").iterdir(),
    ]:
        text = script.read_text()
        assert not re.search("[<>&\u2028\u2029]", text)
        assert text.isascii()
    assert index_of(tmp_path / "site")["ids"][0] == f"0{HOSTILE}"


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "link").symlink_to("real")
    assert build(tmp_path / "link").path == str(tmp_path / "real")
    build(tmp_path / "link", toy_gallery(4), overwrite=True)
    assert (tmp_path / "link").is_symlink()
    assert len(index_of(tmp_path / "real")["ids"]) == 4
    assert entries(tmp_path) == ["link", "real"]
