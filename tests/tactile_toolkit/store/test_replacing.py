"""Starting a folder again: what it held is lost only when something new stands in its place."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

from tactile_toolkit.errors import InputError, SpecMismatchError, StorageError
from tactile_toolkit.run.parts import Finish, Part
from tactile_toolkit.run.processes import InlineRunner, ProcessRunner
from tactile_toolkit.store.build import build
from tactile_toolkit.store.folder import DataFolder, temporary_name
from tests.processes import printed_by
from tests.tactile_toolkit.toy import folder_bytes, toy_plan

REPOSITORY = Path(__file__).resolve().parents[3]
FAILURE = InputError("no place for the third object")


def make(path, plan=None, runner=None, **options):
    return build(DataFolder(str(path)), plan or toy_plan(), runner or InlineRunner(), **options)


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


@pytest.mark.parametrize("runner", [InlineRunner(), ProcessRunner(2)], ids=["inline", "processes"])
def test_a_run_that_finishes_nothing_gives_the_former_set_back(finished, runner):
    before = folder_bytes(finished)
    with pytest.raises(InputError, match="third object"):
        make(finished, other_plan(error=FAILURE), runner, overwrite=True)
    assert folder_bytes(finished) == before


def test_ctrl_c_before_the_first_shard_gives_the_former_set_back(finished):
    before = folder_bytes(finished)

    def stop(progress):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make(finished, other_plan(), on_progress=stop, overwrite=True)
    assert folder_bytes(finished) == before


def test_ctrl_c_at_any_point_before_the_first_shard_gives_the_former_set_back(finished):
    """At the n-th line of the code that puts the former set aside and begins the new one."""
    before, moment, stopped = folder_bytes(finished), 0, True
    while stopped:
        moment += 1
        seen, stopped = 0, False

        def trace(frame, event, _argument):
            nonlocal seen, stopped
            if not frame.f_code.co_filename.endswith(("store/replace.py", "store/build.py", "store/job.py")):
                return None
            if event == "line" and not stopped:
                seen += 1
                if seen == moment:  # noqa: B023
                    stopped = True
                    raise KeyboardInterrupt
            return trace

        def begun(progress):
            sys.settrace(None)
            raise FAILURE

        sys.settrace(trace)
        try:
            with pytest.raises((KeyboardInterrupt, InputError)):
                make(finished, other_plan(), on_progress=begun, overwrite=True)
        finally:
            sys.settrace(None)
        if folder_bytes(finished) != before:
            make(finished, toy_plan(error=RuntimeError("all is there")))
        assert folder_bytes(finished) == before, moment
    assert moment > 50


def test_a_run_that_finished_a_shard_keeps_it_and_goes_on(finished, tmp_path):
    plan = other_plan()
    broken = replace(plan.tasks[1], error=FAILURE)
    with pytest.raises(InputError, match="third object"):
        make(finished, replace(plan, tasks=(plan.tasks[0], broken)), overwrite=True)
    assert sorted(path.name for path in finished.iterdir()) == [".pending", "data", "manifest.json"]
    make(finished, plan)
    make(tmp_path / "fresh", plan)
    assert folder_bytes(finished) == folder_bytes(tmp_path / "fresh")


def test_nothing_is_touched_where_somebody_keeps_files_too(finished):
    (finished / "thesis.tex").write_text("years of work")
    before = folder_bytes(finished)
    with pytest.raises(
        InputError, match=r"more than a data set \(found 'thesis\.tex'\); nothing was changed"
    ):
        make(finished, other_plan(), overwrite=True)
    assert folder_bytes(finished) == before


@pytest.mark.parametrize("path", ["data/my.csv", "previews/mine/holiday.png", "reports/thesis.tex"])
def test_files_of_somebody_among_ours_are_refused(finished, path):
    (finished / path).parent.mkdir(exist_ok=True)
    (finished / path).write_text("years of work")
    before = folder_bytes(finished)
    where = "/".join(path.split("/")[:2])
    with pytest.raises(InputError, match=rf"found '{where}'.*nothing was changed"):
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


def test_nothing_outside_the_folder_goes_with_the_former_set(tmp_path):
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


@pytest.mark.parametrize("runner", [InlineRunner(), Part(0, 1), Finish()], ids=["run", "part", "finish"])
@pytest.mark.parametrize("name", [".pending", ".replaced", ".replaced-gone", "data", "previews", "reports"])
def test_a_link_inside_the_folder_is_followed_by_nothing(finished, tmp_path, name, runner):
    """What it leads to is not of the data set."""
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "thesis.tex").write_text("years of work")
    (outside / "train-00000-of-00004.json").write_text("{}")
    before = folder_bytes(outside)
    if (finished / name).exists():
        (finished / name).rename(tmp_path / "moved")
    (finished / name).symlink_to(outside)
    plans = [toy_plan()] if isinstance(runner, Finish | Part) else [toy_plan(), other_plan()]
    for plan in plans:
        with pytest.raises(InputError, match=rf"{name}' is a symbolic link; .*next: "):
            make(finished, plan, runner, overwrite=plan.spec["seed"] == 2)
        assert folder_bytes(outside) == before
        assert (finished / name).is_symlink()


@pytest.mark.parametrize("name", ["manifest.json", "README.md", "data/train-00000-of-00004.parquet"])
def test_a_file_that_is_a_link_is_not_replaced(finished, tmp_path, name):
    (finished / name).rename(tmp_path / "blob")
    (finished / name).symlink_to(tmp_path / "blob")
    before = folder_bytes(tmp_path)
    with pytest.raises(InputError, match=rf"{name}' is a symbolic link"):
        make(finished, other_plan(), overwrite=True)
    assert folder_bytes(tmp_path) == before


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


def test_a_set_that_cannot_be_moved_stays(finished, monkeypatch):
    before = folder_bytes(finished)
    moved = Path.rename

    def refuse(self, target):
        if self.name == "previews" and ".replaced" in str(target):
            raise PermissionError(13, "Permission denied")
        return moved(self, target)

    monkeypatch.setattr(Path, "rename", refuse)
    with pytest.raises(StorageError, match="permission denied"):
        make(finished, other_plan(), overwrite=True)
    assert folder_bytes(finished) == before


def test_a_run_that_leaves_everything_out_fails_and_leaves_nothing(finished, tmp_path):
    plan = other_plan()
    empty = replace(plan, tasks=tuple(replace(task, ids=(109, 119)) for task in plan.tasks))
    before = folder_bytes(finished)
    with pytest.raises(InputError, match=r"no row is left: all 4 were left out.*nine: 109 ends with 9"):
        make(finished, empty, overwrite=True)
    assert folder_bytes(finished) == before
    for runner in (InlineRunner(), ProcessRunner(2)):
        with pytest.raises(InputError, match="no row is left"):
            make(tmp_path / "fresh", empty, runner)
        assert not (tmp_path / "fresh").exists()


def test_a_split_of_which_nothing_is_left_is_refused_beside_a_finished_one(tmp_path):
    make(tmp_path / "set", toy_plan(("train",)))
    before = folder_bytes(tmp_path / "set")
    plan = toy_plan(("test",))
    nothing = replace(plan, tasks=tuple(replace(task, ids=(109, 119)) for task in plan.tasks))
    with pytest.raises(InputError, match="no row is left"):
        make(tmp_path / "set", nothing)
    assert folder_bytes(tmp_path / "set") == before


def test_a_data_set_in_a_store_is_not_replaced():
    folder = DataFolder("memory://bucket/started-again")
    finished = build(folder, toy_plan(), InlineRunner(), overwrite=True)
    with pytest.raises(
        InputError, match=r"--overwrite replaces none in an object store.*next: choose another"
    ):
        build(folder, other_plan(), InlineRunner(), overwrite=True)
    with pytest.raises(
        SpecMismatchError, match=r"choose another folder \(--out or OUT\), or remove '.*' first$"
    ):
        build(folder, other_plan(), InlineRunner())
    assert build(folder, toy_plan(error=RuntimeError("all is there")), InlineRunner()) == finished


def test_a_folder_that_another_run_is_replacing_is_left_alone(finished):
    aside = finished / ".replaced"
    aside.mkdir()
    (aside / temporary_name("owner")).touch()
    before = folder_bytes(finished)
    with pytest.raises(InputError, match="another run is replacing"):
        make(finished)
    for runner in (Part(0, 2), Finish()):
        with pytest.raises(
            InputError, match=r"is replacing, or was killed .*next: give the command that was"
        ):
            make(finished, runner=runner)
    assert folder_bytes(finished) == before


# Forks a child for every moment, which ends itself as `kill -9` would when it touches the folder for the n-th
# time; then the same run, and one of the former specification, are given in copies of what it left. So is the
# recovery, which is killed at every moment of its own: what the next one makes of that must be the same.
DIES_EVERYWHERE = """
import os, shutil, signal, sys
from dataclasses import replace
from tactile_toolkit.store.build import build
from tactile_toolkit.errors import SpecMismatchError
from tactile_toolkit.run.processes import InlineRunner
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.replace import recover
from tests.tactile_toolkit.toy import folder_bytes, toy_plan
from pathlib import Path

base = Path(sys.argv[1])
former, fresh = folder_bytes(base / "former"), folder_bytes(base / "fresh")
old, new = toy_plan(), toy_plan(("test",), spec={"seed": 2})
new = replace(new, extra_dirs=("images",))

def run(place, plan, **options):
    return build(DataFolder(str(place)), plan, InlineRunner(), **options)

def state(place):
    return {str(path.relative_to(place)): path.is_dir() or path.read_bytes() for path in place.rglob("*")}

def dies_at(moment, place, action):
    # Do something in a child that dies at a moment; tell whether it came that far.
    process = os.fork()
    if process == 0:
        try:
            child(place, moment, action)
        finally:
            os._exit(1)
    _, status = os.waitpid(process, 0)
    assert os.WIFSIGNALED(status) or os.WEXITSTATUS(status) == 0, moment
    return os.WIFSIGNALED(status)

def kill_recoveries(place, begun):
    # Kill the recovery of a folder at every moment of its own, and return how many there are.
    whole = base / "recovered"
    shutil.copytree(place, whole)
    recover(DataFolder(str(whole)))
    expected, moment = state(whole), 0
    shutil.rmtree(whole)
    while True:
        moment += 1
        again = base / "again"
        shutil.copytree(place, again)
        was_killed = dies_at(moment, again, lambda: recover(DataFolder(str(again))))
        recover(DataFolder(str(again)))
        assert state(again) == expected, (begun, moment)
        shutil.rmtree(again)
        if not was_killed:
            return moment - 1

def child(place, moment, action):
    seen = 0
    def watch(event, arguments):
        nonlocal seen
        if event not in ("open", "os.rename", "os.remove", "os.rmdir", "os.mkdir"):
            return
        if not str(arguments[0]).startswith(str(place)):
            return
        if event == "open" and not arguments[2] & os.O_CREAT:
            return
        seen += 1
        if seen == moment:
            os.kill(os.getpid(), signal.SIGKILL)
    sys.addaudithook(watch)
    action()
    os._exit(0)

moment, back, ahead, pairs, seen = 0, 0, 0, 0, []
while True:
    moment += 1
    place = base / f"at-{moment}"
    shutil.copytree(base / "former", place)
    if not dies_at(moment, place, lambda: run(place, new, overwrite=True)):
        break
    left = {path: None if ".writing-" in path else text for path, text in state(place).items()}
    if left not in seen:  # most steps change something
        seen.append(left)
        pairs += kill_recoveries(place, moment)
    second = base / f"again-{moment}"
    shutil.copytree(place, second)
    run(second, new, overwrite=True)
    assert folder_bytes(second) == fresh, moment
    try:
        run(place, replace(old, tasks=tuple(replace(task, error=RuntimeError()) for task in old.tasks)))
    except SpecMismatchError:
        run(place, new)
        assert folder_bytes(place) == fresh, moment
        ahead += 1
    else:
        assert folder_bytes(place) == former, moment
        back += 1
    shutil.rmtree(place)
    shutil.rmtree(second)
print(back, ahead, pairs)
"""


def test_killed_at_any_moment_the_former_set_comes_back_or_the_new_one_goes_on(tmp_path):
    make(tmp_path / "former")
    (tmp_path / "former" / "README.md").write_text("the card")
    make(tmp_path / "fresh", replace(other_plan(), extra_dirs=("images",)))
    back, ahead, pairs = map(int, printed_by(DIES_EVERYWHERE, tmp_path).split())
    assert back > 10
    assert ahead > 10
    assert pairs > 100
