"""Merging: sets with other columns, types, units and classes go together; ids, sources, licences of rows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

import mnist3d
import realtouch
import tactile_sim
from mnist3d.sources.synthetic import SyntheticSource
from realtouch.kind import KIND as TOUCHES
from starstruck_gen.kind import KIND as SCENES
from tactile_toolkit import cards, places
from tactile_toolkit.errors import InputError
from tactile_toolkit.exchange import merge_sets
from tactile_toolkit.exchange.merging import common_type, source_names, unique_ids
from tests.command_line import call
from tests.realtouch import factories, images_of_others
from tests.small_sets import write_scenes

Pair = tuple[Path, Path]
PLAN = tactile_sim.TouchPlan(2, 3, "object", seed=5)


def published(folder: Path, kind: str = "single", size: tuple[int, int] = (32, 24)) -> Path:
    rounds = [factories.make_round(index, 3, size, (4, 6)) for index in range(3)]
    rows = factories.single_rows(rounds) if kind == "single" else factories.seq_rows(rounds)
    return factories.write_set(folder, {"train": rows}, kind)


def recorded(folder: Path, table: str) -> Path:
    """Import three pictures in two classes, with a table."""
    pictures = folder.parent / f"pictures of {folder.name}"
    pictures.mkdir(parents=True)
    for number in range(3):
        (pictures / f"{number}.png").write_bytes(images_of_others.picture(20 * number))
    (pictures / "table.csv").write_text(table)
    realtouch.import_touches(pictures, folder, realtouch.ImportSpec())
    return folder


OWN = "file,label,force_n,slide_mm,in_contact\n0.png,nut,1.5,2,1\n1.png,bolt,2.5,4,0\n2.png,nut,3.5,,1\n"


def clips_and_their_stills(home: Path) -> Pair:
    clips = published(home / "clips", "seq")
    realtouch.clips_to_images(clips, home / "stills")
    return clips, home / "stills"


def images_and_smaller_ones(home: Path) -> Pair:
    images = published(home / "images")
    realtouch.resize(images, home / "small", width=16, height=12)
    return images, home / "small"


def rendered(home: Path, name: str, scenes: Path, **options: Any) -> Path:
    spec = tactile_sim.TouchSetSpec((40, 30), "taxim", plan=PLAN, limit=2, **options)
    tactile_sim.generate(str(scenes), spec, home / name, ["train"])
    return home / name


def forces_and_none(home: Path) -> Pair:
    scenes = write_scenes(home / "scenes")
    press = tactile_sim.ElasticPress(force_n=(1.0, 2.0), markers=(3, 3))
    return rendered(home, "elastic", scenes, press=press), rendered(home, "taxim", scenes)


def own_and_published(home: Path) -> Pair:
    return recorded(home / "own", OWN), published(home / "published")


def real_and_rendered(home: Path) -> Pair:
    return published(home / "real", size=(40, 30)), rendered(home, "taxim", write_scenes(home / "scenes"))


def own_in_other_units(home: Path) -> Pair:
    other = "file,label,slide_m,in_contact\n0.png,gear,0.002,true\n1.png,nut,0.004,false\n2.png,gear,,true\n"
    return recorded(home / "one", OWN), recorded(home / "two", other)


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(
    "make",
    [
        clips_and_their_stills,
        images_and_smaller_ones,
        forces_and_none,
        own_and_published,
        real_and_rendered,
        own_in_other_units,
    ],
)
def test_unlike_sets_merge_and_load(make, tmp_path, capsys):
    first, second = make(tmp_path)
    out = tmp_path / "out"
    assert call("tactile", "merge", first, second, "--out", out, "-w", 1) == 0
    for command in ("tactile verify", "tactile info", "tactile card", "realtouch check"):
        assert call(*command.split(), out, "-q") == 0 or command == "realtouch check"
    olds = [realtouch.load(name, "train") for name in (first, second)]
    merged = realtouch.load(out, "train")
    assert len(merged) == sum(map(len, olds))
    assert len(set(merged.ids.tolist())) == len(merged)
    assert merged.column("source").tolist() == [first.name] * len(olds[0]) + [second.name] * len(olds[1])
    assert merged.column("source_id").tolist() == [str(name) for old in olds for name in old.ids]
    # Each touch has the picture, class, further columns and contact that it had.
    before = [touch for old in olds for touch in old.touches()]
    contact = [is_contact for old in olds for is_contact in old.touches().in_contact()]
    np.testing.assert_array_equal(merged.touches().in_contact(), contact)
    classes = [old.label_names for old in olds for _ in old.touches()]
    for touch, old, old_classes in zip(merged.touches(), before, classes, strict=True):
        np.testing.assert_array_equal(touch.image, old.image)
        assert (touch.label == -1) == (old.label == -1)
        assert touch.label == -1 or merged.label_names[touch.label] == old_classes[old.label]
        assert len(touch.extra) == len(old.extra)
        for name in set(old.extra) & set(touch.extra):
            np.testing.assert_array_equal(touch.extra[name], old.extra[name])
    # Other libraries read it, too.
    import datasets

    rows = datasets.load_dataset(str(out), split="train")
    assert rows["source_id"] == merged.column("source_id").tolist()
    assert len(merged.touches().to_hf()) == len(before)
    # A part of it, and another size, are data sets with the same columns.
    assert call("tactile", "split", out, "--fractions", "0.5,0.5", "--out", tmp_path / "parts", "-w", 1) == 0
    assert call("tactile", "verify", tmp_path / "parts" / "part-1", "-q") == 0
    realtouch.resize(out, tmp_path / "resized", width=20, height=16)
    assert call("tactile", "verify", tmp_path / "resized", "-q") == 0
    resized = realtouch.load(tmp_path / "resized", "train").touches()
    assert resized.in_contact().tolist() == contact
    realtouch.select(out, tmp_path / "contact", contact=True)
    assert len(realtouch.load(tmp_path / "contact", "train").touches()) == sum(contact)
    torch = pytest.importorskip("torch", reason="needs torch, of the extra torch")
    from realtouch.touch_tensors import TouchTensors

    tensors = TouchTensors(
        merged,
        transform=lambda image: torch.nn.functional.interpolate(image[None].float(), (8, 8))[0],
        frames="contact_end",
    )
    batches = list(torch.utils.data.DataLoader(tensors, batch_size=4))
    assert sum(len(images) for images, _ in batches) == len(before)
    if make is clips_and_their_stills:
        with pytest.raises(InputError, match="holds clips and images; expected only one of them"):
            realtouch.clips_to_images(out, tmp_path / "none")
    # The same bytes with two workers.
    merge_sets(TOUCHES, [first, second], str(tmp_path / "again"), workers=2)
    for file in (out / "data").iterdir():
        assert file.read_bytes() == (tmp_path / "again" / "data" / file.name).read_bytes()


def test_columns_are_joined_and_values_converted_to_the_first_unit(tmp_path: Path) -> None:
    first, second = own_in_other_units(tmp_path)
    merge_sets(TOUCHES, [first, second], str(tmp_path / "out"))
    merged = realtouch.load(tmp_path / "out", "train")
    assert merged.label_names == ("bolt", "nut", "gear")
    touches = list(merged.touches())
    assert [merged.label_names[touch.label] for touch in touches] == [
        "nut",
        "bolt",
        "nut",
        "gear",
        "nut",
        "gear",
    ]
    np.testing.assert_allclose([touch.extra["slide_mm"] for touch in touches], [2, 4, np.nan, 2, 4, np.nan])
    assert ["force_n" in touch.extra for touch in touches] == [True] * 3 + [False] * 3


def test_classes_of_digits_are_joined(tmp_path: Path) -> None:
    solid = mnist3d.SolidSpec(target_vertices=2_000)
    folders = [tmp_path / "digits", tmp_path / "others"]
    for folder, seed in zip(folders, (0, 1), strict=True):
        spec = mnist3d.DigitSetSpec(SyntheticSource(seed), solid, per_class=1, limit=3)
        mnist3d.generate(spec, folder, ("test",))
    assert call("tactile", "merge", *folders, "--out", tmp_path / "both", "-w", 1, "-q") == 0
    digits = mnist3d.load(tmp_path / "both", "test")
    olds = [digit for folder in folders for digit in mnist3d.load(folder, "test")]
    assert len(set(digits.ids.tolist())) == len(digits) == len(olds)
    assert all(np.array_equal(new.vertices_m, old.vertices_m) for new, old in zip(digits, olds, strict=True))
    assert digits.column("source_set").tolist() == ["digits"] * 3 + ["others"] * 3
    assert [digit.source for digit in digits] == ["synthetic"] * 6
    assert "- `digits`: mit, 3 rows" in (tmp_path / "both" / "README.md").read_text()


def test_the_card_lists_licences_and_hides_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folders = [recorded(tmp_path / name, OWN) for name in ("one", "two")]
    licences = ("cc-by-nc-4.0", "cc-by-4.0")
    for folder, licence in zip(folders, licences, strict=True):
        assert call("tactile", "card", folder, "--license", licence, "-q") == 0
    out = tmp_path / "out"
    assert call("tactile", "merge", *folders, "--out", out, "-w", 1) == 0
    assert "one: licence cc-by-nc-4.0; two: licence cc-by-4.0" in capsys.readouterr().out
    card = (out / "README.md").read_text()
    assert "license: cc-by-nc-4.0\n" in card
    assert "- `one`: cc-by-nc-4.0, 3 rows" in card
    assert "- `two`: cc-by-4.0, 3 rows" in card
    assert realtouch.load(out, "train").column("licence").tolist() == [*licences[:1] * 3, *licences[1:] * 3]
    assert call("tactile", "card", out, "--license", "mit") == 2
    said = capsys.readouterr().err
    assert "--license is mit, and 3 rows of 'one' are under 'cc-by-nc-4.0'" in said
    assert (out / "README.md").read_text() == card
    assert call("tactile", "card", out, "--license", "cc-by-nc-sa-4.0") == 0
    assert "- `one`: cc-by-nc-4.0, 3 rows" in (out / "README.md").read_text()
    # Rows that state their source keep it.
    assert (
        call("tactile", "merge", out, published(tmp_path / "three"), "--out", tmp_path / "all", "-w", 1) == 0
    )
    names = realtouch.load(tmp_path / "all", "train").column("source").tolist()
    assert names == ["one"] * 3 + ["two"] * 3 + ["three"] * 3
    assert "license: other\n" in (tmp_path / "all" / "README.md").read_text()


@pytest.mark.parametrize(
    ("first", "second", "common"),
    [
        (pa.list_(pa.float32(), 3), pa.list_(pa.float64()), pa.list_(pa.float64())),
        (pa.list_(pa.bool_()), pa.list_(pa.int8()), pa.list_(pa.int8())),
        (pa.list_(pa.duration("us")), pa.list_(pa.float64()), pa.list_(pa.duration("ns"))),
        (pa.list_(pa.float64(), 3), pa.list_(pa.list_(pa.float64(), 3)), pa.list_(pa.list_(pa.float64(), 3))),
        (pa.int64(), pa.string(), None),
        (pa.float64(), pa.list_(pa.list_(pa.float64())), None),
    ],
)
def test_types_are_joined(first, second, common):
    for pair in ((first, second), (second, first)):
        if common is None:
            with pytest.raises(pa.ArrowException):
                common_type(*pair)
        else:
            assert common_type(*pair) == common
    assert common_type(pa.int64(), pa.string(), is_text=True) == pa.string()


def test_impossible_merges_are_refused(tmp_path: Path) -> None:
    one, other = write_scenes(tmp_path / "one", 1), write_scenes(tmp_path / "other", 2)
    link = tmp_path / "link"
    link.symlink_to(one)
    part = next((Path(one) / "data").iterdir())
    for again in (one, f"{one}/../{Path(one).name}", link, part):
        with pytest.raises(InputError, match=r"a data set is given twice: .* have a file in common"):
            merge_sets(SCENES, [one, other, again], str(tmp_path / "out"))
    texts = recorded(tmp_path / "texts", OWN.replace("1.5", "much"))
    with pytest.raises(InputError, match=r"the column 'extra.force_n' is list<.*string> in .*texts"):
        merge_sets(TOUCHES, [recorded(tmp_path / "numbers", OWN), texts], str(tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_new_ids_are_new_in_all_sources(tmp_path: Path) -> None:
    """Also if the first choice of a new id exists already, or an id occurs twice in one source."""
    shards = (["a", "a_2", "b"], ["a", "a", "b_2"], ["a", "a_3"])
    assert unique_ids(shards) == [["a", "a_2", "b"], ["a_4", "a_5", "b_2"], ["a_6", "a_3"]]
    assert unique_ids([[0, 7], [7, 0, 3]]) == [[0, 7], [8, 9, 3]]
    with pytest.raises(InputError, match="no number is left for new ids"):
        unique_ids([[(1 << 63) - 1], [(1 << 63) - 1]])
    folder = write_scenes(tmp_path / "scenes")
    merged = merge_sets(SCENES, [folder, write_scenes(tmp_path / "more", 1)], str(tmp_path / "out"))
    assert merged.spec["options"]["new_ids"] == 5


def test_names_of_sources_are_as_short_as_they_differ(tmp_path: Path) -> None:
    assert source_names(["x/touches", "y/other"]) == ["touches", "other"]
    assert source_names(["x/set", "y/set"]) == ["x/set", "y/set"]
    assert source_names(["s3://bucket/a/set", "hub/name@main"]) == ["set", "name@main"]


def test_copies_keep_the_licence_that_their_source_states(tmp_path: Path) -> None:
    touches = recorded(tmp_path / "touches", OWN)
    digits = tmp_path / "digits"
    words = ("generate", "--split", "test", "--per-class", 1, "--vertices", 2_000)
    assert call("mnist3d", *words, "--out", digits, "-w", 1, "-q") == 0
    copies = {
        "split": ("tactile", "split", "--fractions", "0.5,0.5"),
        "select": ("tactile", "select", "--limit", 2),
    }
    flat = ("tactile", "export", "--format", "flat")
    commands = {
        touches: {**copies, "resize": ("realtouch", "resize", "--size", "32x24"), "flat": flat},
        digits: {**copies, "flat": flat},
    }
    for source, licence in ((touches, "cc-by-nc-4.0"), (digits, "other")):
        assert call("tactile", "card", source, "--license", licence, "-q") == 0
        for name, (program, command, *options) in commands[source].items():
            out = tmp_path / f"{source.name}-{name}"
            assert call(program, command, source, *options, "--out", out, "-w", 1, "-q") == 0
            folder = out / "part-1" if name == "split" else out
            card = (folder / "README.md").read_text()
            assert f"license: {licence}\n" in card, folder
            assert f"\n{licence}, as the card of the source states." in card, folder
            assert cards.licence_of(places.open_place(folder)) == licence
