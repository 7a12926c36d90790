"""``tactile card`` for most kinds of data sets, and that every line of code in a card works."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import datasets
import numpy as np
import pytest
from huggingface_hub import DatasetCard
from PIL import Image

import realtouch
from tests.command_line import call
from tests.realtouch import factories
from tests.realtouch.factories import Layout
from tests.tactile_toolkit.toy import folder_bytes

KINDS = ("mnist3d", "starstruck", "single", "seq", "synthetic", "frames")


def _per_touch_poses(row: dict) -> None:
    count = len(row["pos_in_cell"])
    for part in ("position", "quaternion"):
        row[f"info.object_pose.{part}"] = [row[f"info.object_pose.{part}"]] * count


@pytest.fixture(scope="module")
def folders(tmp_path_factory, digits_set, scenes_set) -> dict[str, Path]:
    """A small data set for each of :data:`KINDS`."""
    root = tmp_path_factory.mktemp("kinds")
    truth = [factories.make_round(index, 4, (64, 48)) for index in range(3)]
    single, seq = root / "from-single", root / "from-seq"
    factories.write_set(single, {"train": factories.single_rows(truth)}, "single")
    factories.write_set(seq, {"train": factories.seq_rows(truth[:1])}, "seq", Layout())
    realtouch.select(str(single), str(root / "single"))
    realtouch.select(str(seq), str(root / "seq"))
    realtouch.export(str(single), str(root / "frames"), "jpeg")
    _write_synthetic(root / "synthetic", factories.single_rows(truth))
    assert call("tactile", "card", root / "synthetic", "--quiet") == 0
    made = {"mnist3d": digits_set, "starstruck": scenes_set}
    return {kind: made.get(kind, root / kind) for kind in KINDS}


def _write_synthetic(folder: Path, rows: list[dict]) -> None:
    """Write a copy of a synthetic set: no manifest, and the pose of the object in each touch."""
    vector = {"position": 3, "quaternion": 4}
    features = factories.features("single", 4)
    for part, width in vector.items():
        features[f"info.object_pose.{part}"] = datasets.List(
            datasets.List(datasets.Value("float64"), length=width), length=4
        )
    for row in rows:
        _per_touch_poses(row)
    import pyarrow as pa
    import pyarrow.parquet as pq

    (folder / "data").mkdir(parents=True)
    table = pa.Table.from_pylist([factories._plain(row) for row in rows], schema=features.arrow_schema)
    pq.write_table(table, folder / "data" / "test-00000-of-00001.parquet")


@pytest.fixture(params=KINDS)
def kind(request) -> str:
    return request.param


def card_of(folder: Path) -> str:
    return (folder / "README.md").read_text()


def blocks(folder: Path) -> list[str]:
    return re.findall(r"```python\n(.*?)```", card_of(folder), flags=re.DOTALL)


@pytest.mark.one_at_a_desk
def test_the_card_was_written_with_the_data_and_is_written_the_same_again(folders, kind, tmp_path, capsys):
    folder = Path(shutil.copytree(folders[kind], tmp_path / kind))
    before = folder_bytes(folder)
    (folder / "README.md").write_text("spoilt")
    shutil.rmtree(folder / "previews")
    assert call("tactile", "card", folder) == 0
    assert re.search(r"wrote README.md, previews/\w+\.png; all of it matches", capsys.readouterr().out)
    assert folder_bytes(folder) == before


@pytest.mark.one_at_a_desk
def test_datasets_follows_the_card(folders, kind):
    loaded = datasets.load_dataset(str(folders[kind]))
    stated = DatasetCard(card_of(folders[kind])).data.dataset_info
    assert {split["name"]: split["num_examples"] for split in stated["splits"]} == {
        name: len(rows) for name, rows in loaded.items()
    }
    assert stated["features"] == next(iter(loaded.values())).info._to_yaml_dict()["features"]
    shards = (folders[kind] / "data").iterdir()
    assert stated["download_size"] == sum(file.stat().st_size for file in shards)
    assert stated["dataset_size"] == sum(split["num_bytes"] for split in stated["splits"])
    streamed = datasets.load_dataset(str(folders[kind]), streaming=True)
    assert set(streamed) == set(loaded)


def test_every_column_is_explained(folders, kind):
    text = card_of(folders[kind])
    columns = [entry["name"] for entry in DatasetCard(text).data.dataset_info["features"]]
    table = text.split("\n## Fields\n")[1].split("\n## ")[0]
    listed = re.findall(r"^\| `([^`]+)` \| [^|]+ \|[^|]*\| [^|]+ \|$", table, flags=re.MULTILINE)
    assert listed == columns
    assert "a column of this copy" not in table


def test_numbers_are_those_of_the_data(folders):
    assert "20 handwritten digits" in card_of(folders["mnist3d"])
    assert "| test | 10 | 0 | 1 |" in card_of(folders["mnist3d"])
    assert "| Class | 1 of each of 10 |" in card_of(folders["mnist3d"])
    assert "39 scenes" in card_of(folders["starstruck"])
    assert "| train | 30 | 1 |" in card_of(folders["starstruck"])
    assert "3 rounds, 12 touches" in card_of(folders["single"])
    assert "one image per\ntouch, 64 x 48 pixels" in card_of(folders["single"])
    assert "| train | 3 | 12 | 4 | 3 | 75.0 % | 0 | 1 |" in card_of(folders["single"])
    assert "12 images of touches" in card_of(folders["frames"])
    assert "no `manifest.json`" in card_of(folders["synthetic"])
    assert "Synthetic touches" in card_of(folders["synthetic"])


def test_digits_in_several_pieces_are_counted(folders, tmp_path):
    assert "None of the digits is in several pieces" in card_of(folders["mnist3d"])
    pixels = np.full((500, 500), 255, np.uint8)
    pixels[100:400, 150:185] = pixels[100:400, 300:335] = 0
    (tmp_path / "own" / "1").mkdir(parents=True)
    Image.fromarray(pixels).save(tmp_path / "own" / "1" / "two.png")
    words = ("generate", "--source", "folder", "--images", tmp_path / "own", "--vertices", "2000", "--quiet")
    assert call("mnist3d", *words, "--workers", "1", "--out", tmp_path / "set") == 0
    assert "1 of 1 digits are in several pieces that print apart" in card_of(tmp_path / "set")


def run_block(block: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    exec(compile(block.replace('"FOLDER"', repr(str(folder))), "card", "exec"), {})


def test_the_lines_that_load_it_work(folders, kind, monkeypatch, capsys):
    with_datasets, with_toolkit, *with_others = blocks(folders[kind])
    assert "tactile_mnist" in (with_others or [card_of(folders[kind])])[0]
    for block in (with_datasets, with_toolkit):
        run_block(block, folders[kind], monkeypatch)
    assert capsys.readouterr().out.strip()


@pytest.mark.oracle
@pytest.mark.parametrize("name", ["mnist3d", "starstruck", "single", "synthetic", "seq"])
def test_the_lines_with_tactile_mnist_work(folders, name, monkeypatch, capsys):
    pytest.importorskip("tactile_mnist", reason="the package tactile-mnist is not installed")
    run_block(blocks(folders[name])[2], folders[name], monkeypatch)
    assert capsys.readouterr().out.strip()


def test_verify_reads_the_card_too(folders, tmp_path, capsys):
    folder = Path(shutil.copytree(folders["starstruck"], tmp_path / "stars"))
    card = folder / "README.md"
    card.write_text(card.read_text().replace("num_examples: 30", "num_examples: 31"))
    assert call("tactile", "verify", folder) == 3
    assert "README.md: num_examples of split 'train' is 31, expected 30" in capsys.readouterr().err
    assert call("tactile", "card", folder, "--quiet") == 0
    assert call("tactile", "verify", folder) == 0


FINGERPRINTS = {
    "synthetic": {"seed": 3, "count": 1_400, "drawing_version": 1},
    "hwdplus": {"shape": [13580, 500, 500], "dtype": "|u1", "images_sample_sha256": "ab" * 32},
    "mnist": {"parts": [{"images": 10_000, "images_sha256": "cd" * 32}]},
    "folder": {"images": 70, "ink": "dark", "sha256": "ef" * 32},
    "mine": {"anything": 1},
}


@pytest.mark.parametrize(
    ("name", "licence", "words"),
    [
        ("synthetic", "mit", "seed 3, 1,400 digits"),
        ("hwdplus", "other", "shape [13580, 500, 500], dtype `|u1`, fingerprint `abababababab`"),
        ("mnist", "cc-by-sa-3.0", "10,000 images of 28 x 28 pixels, fingerprint `cdcdcdcdcdcd`"),
        ("folder", "other", "70 images of a folder, ink dark, fingerprint `efefefefefef`"),
        ("mine", "other", "`mine`: a custom source"),
    ],
)
def test_sources_of_digits_are_named_with_their_terms(name, licence, words):
    from mnist3d.digit_card import source_description, source_words

    source = source_words(name)
    assert source["licence"] == licence
    assert words in source_description(source, {"name": name, **FINGERPRINTS[name]})


def test_what_the_owner_stated_stays_when_the_set_is_replaced(tmp_path, capsys):
    out, few = tmp_path / "set", ("--split", "test", "--vertices", 2_000, "--workers", 1)
    stated = ("--license", "cc-by-4.0", "--author", "Ada Lovelace", "--title", "My digits")
    assert call("mnist3d", "generate", *few, "--limit", 1, "--out", out, *stated) == 0
    assert call("mnist3d", "generate", *few, "--limit", 2, "--out", out, "--overwrite") == 0
    card = DatasetCard.load(out / "README.md")
    assert card.data.license == "cc-by-4.0"
    assert card.text.strip().startswith("# My digits\n\nBy Ada Lovelace.\n")
    assert "2 digits" in capsys.readouterr().out
    other = ("--title", "Other digits", "--overwrite")
    assert call("mnist3d", "generate", *few, "--limit", 3, "--out", out, *other) == 0
    card = DatasetCard.load(out / "README.md")
    assert (card.data.license, card.data.pretty_name) == ("cc-by-4.0", "Other digits")
    assert call("tactile", "verify", out) == 0
