"""Every command on folders of every kind: consistent and correct answers, and no traceback."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import mnist3d
import realtouch
import starstruck_gen
from tactile_toolkit.errors import InputError
from tests.command_line import call
from tests.realtouch import factories
from tests.tactile_toolkit.toy import folder_bytes

READS = ("info", "verify", "preview", "card", "merge", "select", "split", "gallery", "export")
CONTENT = {
    "digits": "digits",
    "scenes": "scenes",
    "wrench": "wrenches",
    "single": "touches",
    "seq": "touches",
    "synthetic": "synthetic touches",
    "imported": "touches",
    "clips": "touches",
    "copied": "digits",
}
OF_MESHES = ("digits", "scenes", "wrenches")


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("sets")

    def run(*words: object) -> None:
        assert call(*map(str, words), "-w", "1", "-q") == 0

    small = ("--split", "test", "--per-class", 1, "--vertices", 2_000)
    run("mnist3d", "generate", *small, "--out", root / "digits")
    run("starstruck", "generate", "--scenes", "test=3,train=6", "--out", root / "scenes")
    assert call("env-assets", "wrench", "--out", str(root / "wrench"), "-q") == 0
    rounds = [factories.make_round(number, 3, (64, 48)) for number in range(3)]
    singles = factories.single_rows(rounds)
    factories.write_set(root / "single", {"train": singles[:2], "test": singles[2:]}, "single")
    factories.write_set(root / "seq", {"train": factories.seq_rows(rounds)}, "seq")
    press = ("--rounds", 1, "--touches", 2, "--optics", "depth")
    run("tactile-sim", "generate", root / "digits", *press, "--out", root / "synthetic")
    run("tactile", "export", root / "single", "--format", "webdataset", "--out", root / "tars")
    run("realtouch", "import", root / "tars", "--format", "webdataset", "--out", root / "imported")
    run("tactile", "export", root / "seq", "--format", "lerobot", "--out", root / "lerobot")
    run("realtouch", "import", root / "lerobot", "--out", root / "clips")
    shutil.rmtree(root / "lerobot")
    run("tactile", "export", root / "digits", "--out", root / "solids", "--limit", 2)
    run("tactile", "merge", root / "digits", "--out", root / "copied")
    run("tactile", "export", root / "digits", "--format", "flat", "--out", root / "flat")
    part = ("--scenes", "test=3,train=3", "--part", "1/2")
    run("starstruck", "generate", *part, "--out", root / "unfinished")
    return root


def options_of(command: str, out: Path) -> tuple[str, ...]:
    written = ("--out", str(out), "-w", "1")
    return {
        "preview": ("--out", str(out), "--dry-run"),
        "merge": written,
        "select": ("--limit", "1", *written),
        "split": ("--fractions", "0.5,0.5", *written),
        "gallery": ("--dry-run", "--out", str(out)),
        "export": ("--format", "flat", "--limit", "1", *written),
    }.get(command, ())


def asked(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str]:
    capsys.readouterr()
    code = call(*words)
    return code, capsys.readouterr().err


def refused(capsys: pytest.CaptureFixture[str], message: str, *words: object, code: int = 2) -> None:
    """Check the exit code of a command, and a part of its message."""
    found, said = asked(capsys, *map(str, words))
    assert (found, message in said) == (code, True), (words, said)


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("name", CONTENT)
def test_every_command_works_on_every_kind(sets, tmp_path, capsys, name):
    folder = Path(shutil.copytree(sets / name, tmp_path / name))
    for command in READS:
        words = options_of(command, tmp_path / "out")
        if command == "preview" and name in ("single", "imported"):
            words = (*words, "--split", "test")
        code, said = asked(capsys, "tactile", command, str(folder), *words)
        if name == "wrench" and command == "split":  # half of one row is no row
            assert code == 2, said
        else:
            assert code == 0, (command, said)
        shutil.rmtree(tmp_path / "out", ignore_errors=True)
    code = call("tactile", "verify", str(folder), "--content", "-q")
    assert code in {"touches": (0, 1)}.get(CONTENT[name], (0,)), "as its commands left it"


def test_rows_of_any_kind_are_shown(sets, capsys):
    for name in (*CONTENT, "flat", "unfinished"):
        assert call("tactile", "show", str(sets / name)) == 0
    assert "note: " in capsys.readouterr().err, "an unfinished set is called so"


def test_options_of_another_kind_are_refused(sets, tmp_path, capsys):
    out = ("--out", str(tmp_path / "out"))
    for words, told in (
        (("preview", "digits", "--round", "1", *out), "--round has no effect on digits"),
        (("preview", "wrench", "--draw", "steps", *out), "steps"),
        (("preview", "seq", "--ids", "3", *out), "--ids has no effect on rounds"),
        (("gallery", "scenes", "--touches", "3", *out), "--touches has no effect on scenes"),
        (("select", "digits", "--contact", *out), "--contact has no effect on digits"),
        (("export", "digits", "--format", "png", *out), "--format is 'png'; expected one of stl, 3mf"),
        (("export", "digits", "--finish", *out), "--finish has no effect on mesh files"),
        (("export", "seq", "--format", "stl", *out), "--format is 'stl'; expected one of png, jpeg"),
        (("export", "seq", *out), "--format is needed; expected one of png, jpeg"),
        (("verify", "digits", "--quick"), "--quick has no effect on the files of digits"),
        (("verify", "digits", "--split", "test"), "--split has no effect on the files of digits"),
    ):
        command, name, *options = words
        refused(capsys, told, "tactile", command, sets / name, *options)
    assert not (tmp_path / "out").exists()


def test_rows_whose_columns_do_not_tell_their_kind_need_it_named(sets, tmp_path, capsys):
    table = pq.read_table(file_of(sets / "digits"))
    table = table.select(
        [name for name in table.column_names if name.split(".")[0] in ("id", "label", "mesh")]
    )
    pq.write_table(table.replace_schema_metadata(None), tmp_path / "train.parquet")
    unknown = "has the columns of several kinds, so that its kind is not known; next: add --kind mnist3d"
    refused(capsys, unknown, "tactile", "info", tmp_path)
    assert asked(capsys, "tactile", "info", str(tmp_path), "--kind", "mnist3d")[0] == 0
    wrong = "--kind is 'digits'; expected one of episodes, mnist3d, realtouch"
    refused(capsys, wrong, "tactile", "info", tmp_path, "--kind", "digits")
    refused(capsys, "holds scenes", "tactile", "info", sets / "scenes", "--kind", "mnist3d")


def test_an_unfinished_set_is_refused_unless_it_is_allowed(sets, tmp_path, capsys):
    folder = str(sets / "unfinished")
    for command in READS:
        code, said = asked(capsys, "tactile", command, folder, *options_of(command, tmp_path / "out"))
        if command not in ("info", "verify"):
            assert code == 3
            assert "is not finished (1 of 2 shards); next: run the same command again, it contin" in said
        assert not (tmp_path / "out").exists()
    for command in ("merge", "select", "split", "export", "gallery", "preview"):
        words = (*options_of(command, tmp_path / command), "--allow-incomplete")
        code, said = asked(capsys, "tactile", command, folder, *words)
        assert code == 0, said
        assert f"note: {folder} is unfinished: 1 of 2 shards" in said
    for made in (tmp_path / "merge", tmp_path / "split" / "part-1", tmp_path / "export"):
        assert call("tactile", "info", str(made)) == 0
        assert '"unfinished": "1 of 2 shards"' in (made / "manifest.json").read_text()


COMMANDS_OF_ONE: dict[tuple[str, str], tuple[str, ...]] = {
    ("realtouch", "load"): ("--split", "train"),
    ("realtouch", "check"): ("-w", "1"),
    ("realtouch", "import"): ("--out", "OUT"),
    ("realtouch", "resize"): ("--size", "32x24", "-w", "1", "--out", "OUT"),
    ("tactile-sim", "generate"): ("--optics", "depth", "--dry-run", "-w", "1", "--out", "OUT"),
    ("tactile-sim", "pairs"): ("--real", "REAL", "--split", "test", "--dry-run", "--out", "OUT"),
}


# Some sets lack the loaded split, some columns of the paper, or enough touches for pairs.
EXIT_CODES = {"load": (0, 2), "check": (0, 1), "import": (2,), "pairs": (2,)}


def words_of(program: str, command: str, place: Path, sets: Path, out: Path) -> list[str]:
    given = {"OUT": str(out), "REAL": str(sets / "single")}
    options = COMMANDS_OF_ONE[program, command]
    return [program, command, str(place), *(given.get(word, word) for word in options)]


@pytest.mark.thorough
@pytest.mark.parametrize("name", CONTENT)
def test_commands_of_one_kind_name_the_kind_of_the_data(sets, tmp_path, capsys, name):
    content = CONTENT[name]
    before = folder_bytes(sets / name)
    for program, command in COMMANDS_OF_ONE:
        code, said = asked(capsys, *words_of(program, command, sets / name, sets, tmp_path / command / "out"))
        wanted = {"realtouch": "touches", "tactile-sim": "meshes"}[program]
        if (content in OF_MESHES) == (wanted == "meshes"):
            assert f"`{program} {command}` is for" not in said
            assert code in EXIT_CODES.get(command, (0,)), said
        else:
            assert code == 2, (command, said)
            assert f"holds {content}; `{program} {command}` is for {wanted}; next: show what" in said
            assert said.count("\n") == 1
        if code:
            assert not (tmp_path / command).exists()
    assert folder_bytes(sets / name) == before


def test_solids_are_pressed_and_exports_are_refused(sets, tmp_path, capsys):
    for name, code in (("solids", 0), ("digits", 0), ("flat", 2), ("tars", 2)):
        words = words_of("tactile-sim", "generate", sets / name, sets, tmp_path / "out")
        assert (found := asked(capsys, *words))[0] == code, found
    assert "holds touches; `tactile-sim generate` is for meshes" in found[1]
    refused(capsys, "was made by `export` for other programs", "mnist3d", "validate", sets / "flat")
    words = ("realtouch", "import", sets / "flat", "--out", tmp_path / "out")
    refused(capsys, "holds digits; `realtouch import` is for touches", *words)


def test_touches_of_an_unfinished_set_record_that(sets, tmp_path, capsys):
    words = words_of("tactile-sim", "generate", sets / "unfinished", sets, tmp_path / "out")
    words = [*(word for word in words if word != "--dry-run"), "--limit", "1", "--rounds", "1"]
    refused(capsys, "; or take what is finished with --allow-incomplete ", *words, code=3)
    assert asked(capsys, *words, "--touches", "1", "--allow-incomplete")[0] == 0
    assert '"unfinished": "1 of 2 shards"' in (tmp_path / "out" / "manifest.json").read_text()


@pytest.fixture
def half_touches(sets, tmp_path) -> str:
    out = str(tmp_path / "half")
    assert call("tactile", "select", str(sets / "single"), "--part", "1/2", "-w", "1", "--out", out) == 0
    return out


def test_unfinished_touches_are_opened_only_if_that_is_allowed(half_touches, capsys):
    """One split has all of its shards; if it is not named, it does not stand for the whole data set."""
    unfinished = "is not finished (1 of 2 shards); next: run the same command again"
    refused(capsys, unfinished, "realtouch", "load", half_touches, code=3)
    for words in (("--allow-incomplete",), ("--split", "train")):
        assert asked(capsys, "realtouch", "load", half_touches, *words)[0] == 0


@pytest.mark.parametrize("program", ["realtouch", "starstruck"])
def test_a_run_without_finished_shards_has_no_rows(sets, half_touches, tmp_path, capsys, program):
    place = Path(half_touches)
    if program == "starstruck":
        place = Path(shutil.copytree(sets / "unfinished", tmp_path / "scenes"))
    for record in (place / ".pending").glob("*.json"):
        record.unlink()
    for command in (*READS, "show"):
        if command not in ("info", "verify", "card"):
            words = options_of(command, tmp_path / "out")
            if command != "show":
                words = (*words, "--allow-incomplete")
            code, said = asked(capsys, "tactile", command, str(place), *words)
            assert code == 3, (command, said)
            assert re.search(
                r"is not finished \(0 of \d shards\); next: run the same command again, it conti", said
            )
            assert not said.endswith("=True)\n"), "that was given"
        assert not (tmp_path / "out").exists()
    assert call("tactile", "info", str(place)) == 0


def test_a_next_step_names_no_option_that_the_command_lacks(half_touches, sets, capsys):
    unfinished = sets / "unfinished"
    for words in (("card", half_touches), ("card", unfinished), ("upload", unfinished, "someone/name")):
        refused(capsys, "next: run the same command again, it continues\n", "tactile", *words, code=3)


def test_records_without_a_manifest_are_a_run_that_was_interrupted(sets, tmp_path, capsys):
    place = Path(shutil.copytree(sets / "unfinished", tmp_path / "set"))
    (place / "manifest.json").unlink()
    for command in ("info", "verify", "show"):
        code, said = asked(capsys, "tactile", command, str(place))
        assert code == 2
        assert "is the folder of a run that was interrupted, and its manifest.json is missing" in said
        assert said.endswith("next: run the same command again, it continues\n")


def save_to_disk(folder: Path) -> None:
    import datasets

    datasets.disable_progress_bars()
    datasets.Dataset.from_dict({"id": [1, 2]}).save_to_disk(str(folder))


def pictures(folder: Path) -> None:
    for name in ("a.png", "b.PNG", "c.jpeg"):
        (folder / name).write_bytes(b"a picture")


def solids_in_classes(folder: Path) -> None:
    for name in ("mug", "fork"):
        (folder / name).mkdir()
        (folder / name / "part.stl").write_bytes(b"solid")


def write(*names: str) -> Callable[[Path], None]:
    def write_them(folder: Path) -> None:
        for name in names:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(b"content")

    return write_them


STRANGERS = {
    "nothing": (lambda _: None, "is empty"),
    "saved": (save_to_disk, "was written by `save_to_disk` of `datasets`"),
    "pictures": (pictures, "is a folder of pictures (3, such as 'a.png')"),
    "solids": (solids_in_classes, "is a folder of meshes (2, such as 'fork/part.stl')"),
    "tars": (write("train-000000.tar"), "is a folder of archives (1, such as 'train-000000.tar')"),
    "zarr": (write(".zgroup", "data/.zgroup"), "is a Zarr array or group"),
    "around zarr": (write("b.zarr/.zgroup"), "holds Zarr arrays"),
    "lerobot": (write("meta/info.json", "data/chunk-000/x.txt"), "is a LeRobotDataset"),
    "interrupted": (
        write(".pending/train-00000-of-00002.json"),
        "is the folder of a run that was interrupted, and its manifest.json is missing",
    ),
    "notes": (write("notes.txt"), "holds no Parquet files (found 'notes.txt')"),
}


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("stranger", STRANGERS)
def test_folders_without_a_data_set_are_described(tmp_path, capsys, stranger):
    make, words = STRANGERS[stranger]
    folder = tmp_path / stranger
    folder.mkdir()
    make(folder)
    before, answers = folder_bytes(folder), set()
    for command in (*READS, "show"):
        code, said = asked(capsys, "tactile", command, str(folder), *options_of(command, tmp_path / "out"))
        assert code == 2
        answers.add(said)
    assert len(answers) == 1, "one answer for one situation"
    assert f"{str(folder)!r} {words}" in (answer := answers.pop())
    assert "; expected a data set of Parquet files; next: " in answer
    assert folder_bytes(folder) == before
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("a.png", "a picture"),
        ("part.STL", "a mesh"),
        ("x.tar", "an archive"),
        ("t.csv", "a table or an array"),
    ],
)
def test_files_without_a_data_set_are_described(tmp_path, capsys, name, words):
    (tmp_path / name).write_bytes(b"content")
    message = f"{name}' is {words}; expected a data set of Parquet files"
    refused(capsys, message, "tactile", "show", tmp_path / name)


def test_a_folder_of_data_sets_names_them(sets, capsys):
    refused(capsys, "has files of split 'train' in ", "tactile", "info", sets)  # two have no manifest
    for name in ("single", "seq"):
        shutil.move(sets / name, sets.parent / name)
    code, said = asked(capsys, "tactile", "info", str(sets))
    for name in ("single", "seq"):
        shutil.move(sets.parent / name, sets / name)
    assert code == 2
    assert "holds 10 data sets (clips, copied, digits); expected" in said


def test_a_manifest_of_another_program_changes_nothing(sets, tmp_path, capsys):
    place = Path(shutil.copytree(sets / "single", tmp_path / "single"))
    (place / "manifest.json").write_text('{"name": "a web page"}')
    for command in ("info", "verify", "card", "merge", "show"):
        words = options_of(command, tmp_path / command)
        code, said = asked(capsys, "tactile", command, str(place), *words)
        assert code == 0, said
    solids = Path(shutil.copytree(sets / "solids", tmp_path / "solids"))
    (solids / "manifest.json").write_text("[]")
    code, said = asked(capsys, "tactile", "info", str(solids))
    assert "is a folder of meshes (2, such as " in said
    words = words_of("tactile-sim", "generate", solids, sets, tmp_path / "out")
    assert asked(capsys, *words)[0] == 0


def test_rows_of_no_kind_are_refused(tmp_path, capsys):
    pq.write_table(pa.table({"x": np.arange(3), "y": ["a", "b", "c"]}), tmp_path / "train.parquet")
    for command in READS:
        words = options_of(command, tmp_path / "out")
        message = "holds rows of no kind of this toolkit (columns x, y); "
        refused(capsys, message, "tactile", command, tmp_path, *words)


def file_of(folder: Path) -> Path:
    return next(iter(sorted((folder / "data").iterdir())))


def test_all_files_and_splits_are_of_one_kind(sets, tmp_path):
    """The first file does not decide for the others: a scene read as a digit would have another class."""
    loaders = {"digits": mnist3d.load, "scenes": starstruck_gen.load, "single": realtouch.load}
    for name, load in loaders.items():
        for other, words in (("digits", "digits"), ("scenes", "scenes"), ("single", "touches")):
            files = [str(file_of(sets / each)) for each in (name, other)]
            if name != other:
                with pytest.raises(InputError, match=rf"holds {words}; `\w+.load` is for "):
                    load(files)
            else:
                assert len(load(files)) == 2 * len(load(files[0]))
    (tmp_path / "data").mkdir()
    for split, name in (("train", "digits"), ("test", "scenes")):
        shutil.copy(file_of(sets / name), tmp_path / "data" / f"{split}-00000-of-00001.parquet")
    assert len(mnist3d.load(tmp_path, "train")) == 10
    with pytest.raises(InputError, match=r"holds scenes; `mnist3d.load` is for digits"):
        mnist3d.load(tmp_path, "test")


def test_files_of_several_sets_have_the_same_classes(sets, tmp_path):
    table = pq.read_table(file_of(sets / "digits"))
    features = json.loads(table.schema.metadata[b"huggingface"])
    features["info"]["features"]["label"]["names"] = ["b", "a"]
    other = table.replace_schema_metadata({"huggingface": json.dumps(features)})
    pq.write_table(other, tmp_path / "other.parquet")
    with pytest.raises(
        InputError, match=r"has the classes 0, 1, .* and b, a; next: open files of one data set"
    ):
        mnist3d.load([file_of(sets / "digits"), tmp_path / "other.parquet"])


def test_exports_are_refused_as_sources(sets, tmp_path, capsys):
    for command in ("merge", "split", "gallery", "preview", "export"):
        words = options_of(command, tmp_path / "out")
        message = "was made by `export` for other programs; expected a data set with rows of its kind"
        refused(capsys, message, "tactile", command, sets / "flat", *words)
