"""A data set that independent processes make in parts: its bytes are those of one process."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest

from tactile_toolkit.errors import InputError, SpecMismatchError, StorageError
from tactile_toolkit.run import Part
from tactile_toolkit.run.runners import ProcessRunner
from tactile_toolkit.store import Manifest, build, open_folder, read_manifest, verify
from tactile_toolkit.store.folder import LocalFolder
from tactile_toolkit.store.job import MissingPartsError, array_text
from tests.tactile_toolkit.toy import SCHEMA, folder_bytes, make, toy_plan

SHARDS = 6


@pytest.fixture
def whole(tmp_path) -> dict[str, bytes]:
    make(tmp_path / "whole")
    return folder_bytes(tmp_path / "whole")


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("count", [4, 1, 100])
def test_parts_in_any_order_give_the_bytes_of_one_process(tmp_path, whole, count):
    folder = open_folder(str(tmp_path / "set"))
    for number in random.Random(count).sample(range(1, count + 1), count):  # from 1, as many arrays are
        manifest = make(folder.root, part=Part(number, count))
        assert not manifest.complete
        first = (number % count) % SHARDS
        if number % count < SHARDS:
            assert (tmp_path / "set" / toy_plan().tasks[first].shard.data_path).is_file()
            assert read_manifest(folder).shards == ()
    assert not Manifest.so_far(folder).complete
    for _ in range(2):  # a repeated part makes no difference
        assert make(folder.root, finish=True).complete
        assert folder_bytes(tmp_path / "set") == whole


def test_damage_of_the_same_size_counts_as_missing_where_all_is_read(tmp_path, whole):
    folder = open_folder(str(tmp_path / "set"))
    make(folder.root, part=Part(0, 2))
    make(folder.root, part=Part(1, 2))
    path = toy_plan().tasks[1].shard.data_path
    content = bytearray(folder.read_bytes(path))
    content[len(content) // 2] ^= 1
    folder.write_bytes(path, bytes(content))
    make(folder.root, part=Part(1, 2))
    assert folder.read_bytes(path) == content  # parts compare only sizes
    with pytest.raises(MissingPartsError) as caught:
        make(folder.root, check=True, finish=True)
    assert (caught.value.array, caught.value.parts) == ("1", SHARDS)
    make(folder.root, check=True, part=Part(1, 2))
    assert make(folder.root, check=True, finish=True).complete
    assert folder_bytes(tmp_path / "set") == whole


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("runner", [1, ProcessRunner(2)], ids=["inline", "processes"])
def test_missing_parts_are_listed_as_numbers_of_an_array(tmp_path, whole, runner):
    for index in (0, 5):
        make(tmp_path / "set", part=Part(index, SHARDS), workers=runner)
    for _ in range(2):
        with pytest.raises(
            MissingPartsError,
            match=r"4 of 6 shards of '.*set' are not finished, .* parts 1-4 of 6.*auto/6.*--array=1-4",
        ) as error:
            make(tmp_path / "set", finish=True)
        assert (error.value.array, error.value.exit_code) == ("1-4", 3)
    for index in (1, 2, 3, 4):
        make(tmp_path / "set", part=Part(index, SHARDS))
    make(tmp_path / "set", finish=True)
    assert folder_bytes(tmp_path / "set") == whole


@pytest.mark.parametrize("place", ["{}/set", "memory://nothing-to-finish"])
def test_without_finished_parts_the_set_cannot_be_finished(tmp_path, place):
    folder = place.format(tmp_path)
    make(folder, part=Part(SHARDS, SHARDS + 1))  # there are fewer shards than parts
    with pytest.raises(MissingPartsError, match=f"{SHARDS} of {SHARDS} shards of .* are not finished"):
        make(folder, finish=True)


@pytest.mark.parametrize("damage", ["file gone", "file cut", "record gone", "record cut", "report cut"])
def test_a_record_counts_only_with_its_whole_file(tmp_path, whole, damage):
    for index in range(2):
        make(tmp_path / "set", part=Part(index, 2))
    shard = toy_plan().tasks[3].shard
    victim = {"file": shard.data_path, "record": shard.record_path, "report": shard.report_path}
    file = tmp_path / "set" / victim[damage.split()[0]]
    if damage.endswith("cut"):
        file.write_bytes(file.read_bytes()[:-40])
    else:
        file.unlink()
    with pytest.raises(MissingPartsError, match=r"1 of 6 shards .* those of part 3 of 6"):
        make(tmp_path / "set", finish=True)
    so_far = Manifest.so_far(open_folder(str(tmp_path / "set")))
    assert len(so_far.shards) == SHARDS - 1
    made = []
    make(tmp_path / "set", part=Part(1, 2), on_progress=lambda told: made.append(told.record))
    assert [record.shard for record in made[1:]] == [shard]
    make(tmp_path / "set", finish=True)
    assert folder_bytes(tmp_path / "set") == whole


def test_parts_of_other_sets_are_refused(tmp_path):
    plan = toy_plan()
    make(tmp_path / "set", part=Part(0, 4))
    before = folder_bytes(tmp_path / "set")
    other = toy_plan(spec={"seed": 2, "size": [1, 2]})
    for mode in ({"part": Part(1, 4)}, {"finish": True}, {}):
        with pytest.raises(SpecMismatchError, match="seed is 1 there, 2 was asked for"):
            make(tmp_path / "set", other, **mode)
    for mode in ({"part": Part(1, 4)}, {"finish": True}):
        with pytest.raises(InputError, match=r"overwrite was given with --part.*choose another folder"):
            make(tmp_path / "set", **mode, overwrite=True)
    assert folder_bytes(tmp_path / "set") == before
    make(tmp_path / "libraries", replace(plan, libraries=("numpy",)), part=Part(0, 4))
    with pytest.raises(SpecMismatchError, match=r"libraries\.numpy is '[\d.]+' there, None was asked for"):
        make(tmp_path / "libraries", plan, part=Part(1, 4))


@pytest.mark.parametrize("seed", [1, 2])
def test_of_two_first_parts_at_the_same_moment_the_later_is_held_to_the_other(tmp_path, monkeypatch, seed):
    create, first = LocalFolder.create_bytes, toy_plan(spec={"seed": seed, "size": [1, 2]}).new_manifest()

    def just_behind(folder, path, content):
        create(folder, path, first.to_json().encode())
        return create(folder, path, content)

    monkeypatch.setattr(LocalFolder, "create_bytes", just_behind)
    if seed == 1:
        make(tmp_path / "set", part=Part(1, 4))
        return
    with pytest.raises(SpecMismatchError, match="seed is 2 there, 1 was asked for"):
        make(tmp_path / "set", part=Part(1, 4))
    assert folder_bytes(tmp_path / "set") == {"manifest.json": first.to_json().encode()}


def test_a_folder_that_was_not_made_in_parts_is_finished_too(tmp_path, whole):
    with pytest.raises(MissingPartsError, match=r"6 of 6 shards of '.*nothing' are not finished"):
        make(tmp_path / "nothing", finish=True)
    assert not (tmp_path / "nothing").exists()
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "thesis.tex").write_text("years of work")
    for mode in ({"part": Part(0, 2)}, {"finish": True}):
        with pytest.raises(InputError, match=r"not empty.*thesis\.tex"):
            make(tmp_path / "thesis", **mode)
    assert folder_bytes(tmp_path / "thesis") == {"thesis.tex": b"years of work"}
    plan = toy_plan()
    with pytest.raises(StorageError, match="full"):
        make(
            tmp_path / "set",
            plan=replace(
                plan, tasks=(*plan.tasks[:-1], replace(plan.tasks[-1], error=StorageError("disk full")))
            ),
        )
    with pytest.raises(MissingPartsError, match=r"1 of 6 shards.*or run the same command without --finish"):
        make(tmp_path / "set", finish=True)
    make(tmp_path / "set")
    make(tmp_path / "set", finish=True)
    assert folder_bytes(tmp_path / "set") == whole


def test_finishing_clears_up_after_all_writers(tmp_path, whole):
    for index in range(2):
        make(tmp_path / "set", part=Part(index, 2))
    left = tmp_path / "set" / ".pending" / "tmp-0123456789abcdef0123456789abcdef"
    left.write_bytes(b"half")
    make(tmp_path / "set", part=Part(1, 2))
    assert left.exists()
    make(tmp_path / "set", finish=True)
    assert folder_bytes(tmp_path / "set") == whole
    assert verify(open_folder(str(tmp_path / "set")), SCHEMA).ok


def test_parts_in_a_store_of_objects(whole):
    folder = open_folder("memory://bucket/parts")
    for index in (0, 2):
        build(folder, toy_plan(), part=Part(index, 3))
    with pytest.raises(MissingPartsError, match="--array=1,4"):
        build(folder, toy_plan(), finish=True)
    build(folder, toy_plan(), part=Part(1, 3))
    build(folder, toy_plan(), finish=True)
    assert {path: folder.read_bytes(path) for path in whole} == whole
    assert folder.names(".pending") == []


def test_records_of_another_job_prove_nothing(tmp_path, whole):
    """A user removed the manifest of an interrupted run, and began another set there."""
    other = toy_plan(spec={"seed": 2, "size": [1, 2]})
    make(tmp_path / "set", other, part=Part(0, 2))
    (tmp_path / "set" / "manifest.json").unlink()
    (tmp_path / "set" / "data").rename(tmp_path / "data")
    with pytest.raises(StorageError, match="full"):
        make(tmp_path / "set", plan=toy_plan(error=StorageError("disk full")))
    make(tmp_path / "set", part=Part(0, 2))
    assert len(list((tmp_path / "set" / "data").iterdir())) == 3
    make(tmp_path / "set")
    assert folder_bytes(tmp_path / "set") == whole


SLURM = {"COUNT": "500", "MIN": "0", "MAX": "499", "ID": "17"}


def slurm(**values: str) -> dict[str, str]:
    return {f"SLURM_ARRAY_TASK_{name}": value for name, value in (SLURM | values).items()}


@pytest.mark.parametrize(
    ("text", "environment", "expected"),
    [
        ("17/500", {}, Part(17, 500)),
        ("500/500", {}, Part(500, 500)),
        ("auto", slurm(), Part(17, 500)),
        ("auto", slurm(MIN="1", MAX="500"), Part(17, 500)),
        ("auto/500", slurm(COUNT="7", MIN="3", MAX="44"), Part(17, 500)),
        ("auto/9", {"JOB_COMPLETION_INDEX": "0"}, Part(0, 9)),
        ("auto", {"JOB_COMPLETION_INDEX": "0", "JOB_COMPLETION_COUNT": "9"}, Part(0, 9)),
    ],
)
def test_a_part_is_named_or_taken_from_the_scheduler(text, environment, expected):
    assert Part.parse(text, environment) == expected


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("17", "expected K/N, such as 17/500"),
        ("-1/4", "expected K/N"),
        ("1/4/2", "expected K/N"),
        ("5/4", "there is no part 5 of 4; expected 0 to 3"),
        ("0/0", "there is no part 0 of 0; expected at least 1 part"),
        ("auto", "neither SLURM_ARRAY_TASK_ID nor JOB_COMPLETION_INDEX is a number"),
    ],
)
def test_invalid_parts_are_refused(text, told):
    with pytest.raises(InputError, match=told):
        Part.parse(text, {"SLURM_ARRAY_TASK_ID": ""})


@pytest.mark.parametrize(
    "array",
    [{"COUNT": "7", "MIN": "3", "MAX": "44"}, {"COUNT": "250", "MAX": "498"}],
    ids=["--array=3,17,40-44", "with steps"],
)
def test_a_partial_array_needs_the_number_of_parts(array):
    with pytest.raises(InputError, match=r"the number of parts is unknown.*auto/N"):
        Part.parse("auto", slurm(**array))


def test_numbers_are_written_as_slurm_takes_them():
    assert array_text([44, 3, 17, 41, 40, 42, 43, 3]) == "3,17,40-44"
    assert array_text([7]) == "7"
