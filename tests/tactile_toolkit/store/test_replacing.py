"""Replacing a data set: the former one is removed only when the new one is complete."""

from __future__ import annotations

import contextlib
import errno
import os
from dataclasses import replace
from pathlib import Path

import pytest

from tactile_toolkit.errors import InputError, SpecMismatchError, StorageError, ToolkitError
from tactile_toolkit.places import open_place
from tactile_toolkit.run import Part
from tactile_toolkit.run.runners import InlineRunner, ProcessRunner
from tactile_toolkit.store import build, open_folder, read_manifest
from tactile_toolkit.store.folder import LocalFolder
from tests.tactile_toolkit.toy import folder_bytes, make, toy_plan

FAILURE = InputError("no place for the third object")


def other_plan(**options):
    return toy_plan(("test",), spec={"seed": 2}, **options)


@pytest.fixture
def finished(tmp_path):
    """A finished set with a card and a picture, as conversions write them."""
    make(tmp_path / "set")
    (tmp_path / "set" / "README.md").write_text("the card")
    (tmp_path / "set" / "previews").mkdir()
    (tmp_path / "set" / "previews" / "some.png").write_bytes(b"picture")
    return tmp_path / "set"


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("runner", [InlineRunner(), ProcessRunner(2)], ids=["inline", "processes"])
def test_a_run_without_finished_shards_keeps_the_former_state(finished, tmp_path, runner):
    """The former set, an empty folder, which accepts another specification then, or no folder."""
    before = folder_bytes(finished)
    (tmp_path / "empty").mkdir()
    for place, options in (
        (finished, {"overwrite": True}),
        (tmp_path / "empty", {}),
        (tmp_path / "none", {}),
    ):
        with pytest.raises(InputError, match="third object"):
            make(place, other_plan(error=FAILURE), workers=runner, **options)
    assert folder_bytes(finished) == before
    assert list((tmp_path / "empty").iterdir()) == []
    assert not (tmp_path / "none").exists()
    assert make(tmp_path / "empty", toy_plan(spec={"seed": 9})).complete


def test_the_first_error_is_reported(tmp_path, monkeypatch):
    """Not the later failure to clean up on the full disk."""
    left = tmp_path / "set" / ".pending" / "tmp-0123456789abcdef0123456789abcdef"

    def stop(progress):
        left.parent.mkdir(exist_ok=True)
        left.touch()

        def refuse(*_, **__):
            raise OSError(errno.EIO, os.strerror(errno.EIO))

        for name in ("unlink", "rename", "replace", "iterdir", "glob"):
            monkeypatch.setattr(Path, name, refuse)
        raise FAILURE

    for overwrite in (False, True):
        with monkeypatch.context(), pytest.raises(InputError, match="third object"):
            make(tmp_path / "set", toy_plan(), on_progress=stop, overwrite=overwrite)
        monkeypatch.undo()
        make(tmp_path / "set", toy_plan())


def test_a_set_that_others_began_in_its_place_is_begun_again(finished, tmp_path):
    third = toy_plan(("test",), spec={"seed": 3})
    with pytest.raises(InputError, match="third object"):
        make(
            finished,
            replace(third, tasks=(third.tasks[0], replace(third.tasks[1], error=FAILURE))),
            overwrite=True,
        )
    make(finished, other_plan(), overwrite=True)
    make(tmp_path / "fresh", other_plan())
    assert folder_bytes(finished) == folder_bytes(tmp_path / "fresh")


def test_readers_wait_for_a_replacement_that_was_begun(finished, tmp_path, monkeypatch):
    """A replacement that was killed is completed when the set is opened."""
    make(tmp_path / "fresh", replace(other_plan(), kind="toy"))
    moved = []
    move = LocalFolder.move

    def stop(folder, path, target):
        if moved:
            raise KeyboardInterrupt
        moved.append(path)
        move(folder, path, target)

    with monkeypatch.context() as patch:
        patch.setattr(LocalFolder, "move", stop)
        with pytest.raises(KeyboardInterrupt):
            make(finished, other_plan(), overwrite=True)
    assert not read_manifest(open_folder(str(finished))).complete
    assert len(open_place(str(finished)).shards("test")) == 2
    assert folder_bytes(finished) == folder_bytes(tmp_path / "fresh")


@pytest.mark.parametrize("path", ["data/my.csv", "previews/mine/holiday.png", "reports/thesis.tex"])
def test_files_of_somebody_among_ours_are_refused(finished, path):
    (finished / path).parent.mkdir(exist_ok=True)
    (finished / path).write_text("years of work")
    before = folder_bytes(finished)
    with pytest.raises(InputError, match=rf"found '{path}'.*nothing was changed"):
        make(finished, other_plan(), overwrite=True)
    assert folder_bytes(finished) == before


@pytest.mark.parametrize("beside", [(), ("data/measurements.csv",)])
def test_a_manifest_of_somebody_else_is_no_data_set(tmp_path, beside):
    """Web apps and browser extensions have a manifest.json, too."""
    for path in ("manifest.json", "README.md", *beside):
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).write_text('{"name": "my web app"}')
    before = folder_bytes(tmp_path)
    with pytest.raises(InputError, match="nothing was changed"):
        make(tmp_path, overwrite=True)
    assert folder_bytes(tmp_path) == before


def test_all_that_the_former_set_wrote_beside_its_rows_goes(tmp_path):
    make(tmp_path / "set", replace(toy_plan(), extra_dirs=("images", "index.csv")))
    (tmp_path / "set" / "images" / "train" / "0").mkdir(parents=True)
    (tmp_path / "set" / "images" / "train" / "0" / "000.png").write_bytes(b"picture")
    (tmp_path / "set" / "index.csv").write_text("id")
    make(tmp_path / "set", other_plan(), overwrite=True)
    make(tmp_path / "fresh", other_plan())
    assert folder_bytes(tmp_path / "set") == folder_bytes(tmp_path / "fresh")
    assert not (tmp_path / "set" / "images").exists()


def test_files_outside_of_the_folder_are_not_removed_with_the_former_set(tmp_path):
    """A folder of pictures may be a link."""
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "thesis.tex").write_text("years of work")
    make(tmp_path / "set", replace(toy_plan(), extra_dirs=("images",)))
    (tmp_path / "set" / "images").symlink_to(outside)
    before = folder_bytes(tmp_path)
    with pytest.raises(InputError, match=r"images' is a symbolic link"):
        make(tmp_path / "set", other_plan(), overwrite=True)
    assert folder_bytes(tmp_path) == before


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("mode", [{}, {"part": Part(0, 1)}, {"finish": True}], ids=["run", "part", "finish"])
@pytest.mark.parametrize("name", [".pending", ".next", "data", "previews", "reports"])
def test_links_inside_the_folder_are_not_followed(finished, tmp_path, name, mode):
    """Its target does not belong to the data set."""
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "thesis.tex").write_text("years of work")
    (outside / "train-00000-of-00004.json").write_text("{}")
    before = folder_bytes(outside)
    if (finished / name).exists():
        (finished / name).rename(tmp_path / "moved")
    (finished / name).symlink_to(outside)
    plans = [toy_plan()] if mode else [toy_plan(), other_plan()]
    for plan in plans:
        is_overwritten = plan.spec["seed"] == 2
        # A run that writes nothing there may succeed.
        refused = pytest.raises(InputError, match=rf"{name}' is a symbolic link; .*next: ")
        with refused if is_overwritten else contextlib.suppress(ToolkitError):
            make(finished, plan, **mode, overwrite=is_overwritten)
        assert folder_bytes(outside) == before
        assert (finished / name).is_symlink()


def test_the_folder_itself_may_be_a_link(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "set").symlink_to("real")
    make(tmp_path / "set", toy_plan())
    make(tmp_path / "set", other_plan(), overwrite=True)
    make(tmp_path / "fresh", other_plan())
    assert folder_bytes(tmp_path / "real") == folder_bytes(tmp_path / "fresh")
    assert (tmp_path / "set").is_symlink()


def test_a_damaged_manifest_does_not_stop_a_new_start(finished, tmp_path):
    (finished / "manifest.json").write_text('{"schema_version": 1')
    make(finished, other_plan(), overwrite=True)
    make(tmp_path / "fresh", other_plan())
    assert folder_bytes(finished) == folder_bytes(tmp_path / "fresh")


def test_a_set_that_cannot_be_moved_now_is_moved_by_the_next_run(finished, tmp_path, monkeypatch):
    make(tmp_path / "fresh", other_plan())
    replaced = Path.replace

    def refuse(self, target):
        if self.name.startswith("test-00001"):
            raise PermissionError(13, "Permission denied")
        return replaced(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", refuse)
        with pytest.raises(StorageError, match="Permission denied"):
            make(finished, other_plan(), overwrite=True)
    make(finished, other_plan(error=RuntimeError("all is there")))
    assert folder_bytes(finished) == folder_bytes(tmp_path / "fresh")


def test_a_run_that_leaves_everything_out_fails_and_keeps_the_former_state(finished, tmp_path):
    """Also for a split beside a finished one."""
    plan = other_plan()
    empty = replace(plan, tasks=tuple(replace(task, ids=(109, 119)) for task in plan.tasks))
    make(tmp_path / "train", toy_plan(("train",), spec={"seed": 2}))
    before = folder_bytes(tmp_path)
    for place, options in (
        (finished, {"overwrite": True}),
        (tmp_path / "none", {}),
        (tmp_path / "train", {}),
    ):
        with pytest.raises(InputError, match=r"no row is left: all 4 were left out.*nine: 109 ends with 9"):
            make(place, empty, **options)
    assert folder_bytes(tmp_path) == before
    assert not (tmp_path / "none").exists()


def test_a_data_set_in_a_store_is_not_replaced():
    folder = open_folder("memory://bucket/started-again")
    finished = build(folder, toy_plan(), overwrite=True)
    with pytest.raises(
        InputError, match=r"--overwrite does not work in an object store.*next: choose another"
    ):
        build(folder, other_plan(), overwrite=True)
    with pytest.raises(
        SpecMismatchError, match=r"choose another folder .* or start again there with --overw"
    ):
        build(folder, other_plan())
    assert build(folder, toy_plan(error=RuntimeError("all is there"))) == finished


def test_files_of_the_user_in_hidden_folders_of_a_run_stay(finished, tmp_path):
    """Names that only begin like ours belong to the user."""
    theirs = (
        ".pending/tmp-notes",
        ".pending/notes.json",
        ".pending/old/train-00000-of-00004.json",
        ".next/thesis.tex",
    )
    ours = (".pending/tmp-0123456789abcdef0123456789abcdef", ".pending/train-00007-of-00009.json")
    of_next = ".next/README.md"
    for path in (*theirs, *ours, of_next):
        (finished / path).parent.mkdir(parents=True, exist_ok=True)
        (finished / path).write_text("years of work")
    make(finished)
    left = {path for path in folder_bytes(finished) if path.startswith(".")}
    assert left == {*theirs, of_next}, "a run that replaces the set may be at work there"
    with pytest.raises(InputError, match=r"holds more than a data set .*'\.pending/notes\.json'"):
        make(finished, other_plan(), overwrite=True)
    (finished / ".pending").rename(tmp_path / "pending")
    with pytest.raises(InputError, match=r"\.next' is not empty .*'thesis\.tex'"):
        make(finished, other_plan(), overwrite=True)
    assert not (finished / of_next).exists()
    (finished / ".next" / "thesis.tex").rename(tmp_path / "thesis.tex")
    make(finished, other_plan(), overwrite=True)
    assert not [path for path in folder_bytes(finished) if path.startswith(".")]


def test_nothing_is_removed_through_a_link_in_a_folder_of_a_run(finished, tmp_path):
    outside = tmp_path / "outside"
    make(outside)
    (outside / "empty").mkdir()
    (finished / ".next").mkdir()
    (finished / ".next" / "data").symlink_to(outside / "data")
    (finished / ".next" / "previews").symlink_to(outside)
    before = folder_bytes(outside)
    with pytest.raises(InputError, match="is a symbolic link; nothing is written, moved or removed"):
        make(finished, other_plan(), overwrite=True)
    assert folder_bytes(outside) == before
    assert (outside / "empty").is_dir()
