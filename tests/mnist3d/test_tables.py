"""Digits in tables and arrays that are shared in place of the files of MNIST."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mnist3d.sources import MnistSource, TableSource
from mnist3d.sources.digit_source import NO_WRITER
from tests.command_line import call
from tests.mnist3d.mnist_files import bars, write
from tests.mnist3d.sources import refusal

IMAGES, LABELS = bars(6)
HEADER = ",".join(["label", *(f"pixel{number}" for number in range(784))])


def lines(labels: NDArray[np.uint8] = LABELS, last: bool = False) -> str:
    rows = [
        [*row, label] if last else [label, *row]
        for label, row in zip(labels.tolist(), IMAGES.reshape(6, 784).tolist(), strict=True)
    ]
    return "\n".join(",".join(map(str, row)) for row in rows)


def csv(text: str, name: str = "train.csv"):
    return lambda folder: (folder / name).write_text(text)


def npz(name: str = "digits.npz", **arrays):
    return lambda folder: np.savez(folder / name, **arrays)


def npy(**arrays):
    return lambda folder: [np.save(folder / f"{name}.npy", array) for name, array in arrays.items()]


TWICE = {"images": IMAGES, "labels": LABELS, "labels_of_writers": LABELS[::-1]}


@pytest.mark.parametrize(
    "write_files",
    [
        csv(f"{HEADER}\n{lines()}\n"),
        csv(lines(), "mnist_train.csv"),
        csv(f"\ufeff{HEADER}\r\n{lines()}".replace(",", ";")),
        csv(HEADER.replace("label,", "") + f",label\n{lines(last=True)}"),
        csv(HEADER.replace("label", '"label"') + f"\n{lines()}"),
        npz(x_train=IMAGES[:4], y_train=LABELS[:4], x_test=IMAGES[4:], y_test=LABELS[4:]),
        npz(train_images=IMAGES[..., None], train_labels=LABELS[:, None]),
        npz(images=IMAGES.reshape(6, 784).astype(float) / 255, labels=LABELS.astype(float)),
        npz(**TWICE),
        npy(images=IMAGES.reshape(6, 784).astype(np.int64), labels=LABELS.astype(str)),
    ],
)
def test_every_table_gives_the_digits_of_mnist(tmp_path: Path, write_files) -> None:
    write(tmp_path / "idx", "test", IMAGES, LABELS)
    reference = MnistSource(str(tmp_path / "idx"))
    folder = tmp_path / "tables"
    folder.mkdir()
    write_files(folder)
    paths = [folder, *folder.iterdir()] if len(list(folder.iterdir())) == 1 else [folder]
    for path in paths:
        source = TableSource(str(path))
        catalog = source.catalog()
        images = [source.image(digit_id) for digit_id in catalog.ids]
        order = np.argsort([image.pixels.sum() for image in images])
        expected = sorted(range(6), key=lambda row: reference.image(row).pixels.sum())
        assert [images[row].label for row in order] == LABELS[expected].tolist()
        for row, digit_id in zip(order, expected, strict=True):
            np.testing.assert_array_equal(images[row].pixels, reference.image(digit_id).pixels)
        assert set(catalog.writers.tolist()) == {NO_WRITER}


def test_other_files_are_left_out_with_the_reason(tmp_path: Path) -> None:
    csv(f"{HEADER}\n{lines()}\n")(tmp_path)
    csv(HEADER.replace("label,", "") + "\n", "test.csv")(tmp_path)
    (tmp_path / "readme.txt").write_text("digits")
    (tmp_path / "more").mkdir()
    npz(images=IMAGES, labels=LABELS, thumbnails=IMAGES[:, ::2, ::2])(tmp_path)
    assert TableSource(str(tmp_path)).fingerprint()["left_out"] == {
        "digits.npz/thumbnails.npy": "neither digits nor their labels",
        "more": "a folder",
        "readme.txt": "not a table or array",
        "test.csv": "784 columns, but no row of a label and 784 pixels",
    }


def test_a_missing_path_is_named() -> None:
    assert "nowhere.csv does not exist" in refusal(TableSource("nowhere.csv"))


def packed_by_another_method(folder: Path) -> None:
    stream = io.BytesIO()
    np.save(stream, IMAGES)
    with zipfile.ZipFile(folder / "a.npz", "w", zipfile.ZIP_BZIP2) as archive:
        archive.writestr("images.npy", stream.getvalue())


@pytest.mark.parametrize(
    ("write_files", "words"),
    [
        (lambda folder: None, "found no digits"),
        (csv("id,label\n1,2\n"), "train.csv: 2 columns, but no row of a label and 784 pixels"),
        (csv(f"{HEADER}\n"), "785 columns, but no row"),
        (csv(f"{HEADER.replace('label', 'class')}\n{lines()}"), "no column is called 'label'"),
        (csv(f"{HEADER}\n{lines()},1"), "cannot be read as a table"),
        (csv(f"{HEADER}\n1,2,3\n4,5,6"), "rows of 3 values"),
        (csv(f"{HEADER}\n{lines().replace('255', '256')}"), "'256'"),
        (csv(f"{HEADER}\n{lines(LABELS + 20)}"), "expected a digit from 0 to 9"),
        (csv(f"{HEADER}\n{lines()}", "emnist-digits-train.csv"), "rows and columns exchanged"),
        (npz(images=IMAGES), "0 arrays can be the labels"),
        (npz(images=IMAGES, labels=LABELS, targets=LABELS), "2 arrays can be the labels"),
        (npz(images=IMAGES, labels=LABELS[:5]), "0 arrays can be the labels"),
        (npz(images=IMAGES * 1.0 - 300, labels=LABELS), "found pixels from -300"),
        (npz(images=IMAGES * np.nan, labels=LABELS), "NaN or infinity"),
        (npz(images=IMAGES, labels=np.array([{}] * 6)), "cannot be read"),
        (npz(images=IMAGES, labels=LABELS, scale=np.float64(1), x=IMAGES[:0]), ""),
        (lambda folder: (folder / "a.npz").write_bytes(b"PK\x03\x04"), "cannot be read"),
        (packed_by_another_method, "packed by method 12"),
        (npy(labels=LABELS), "found no digits"),
    ],
)
def test_unusable_tables_are_refused(tmp_path: Path, write_files, words: str) -> None:
    write_files(tmp_path)
    source = TableSource(str(tmp_path))
    if words:
        assert words in refusal(source)
    else:
        assert len(source.catalog()) == 6


def test_a_table_becomes_a_data_set_without_the_licence_of_mnist(tmp_path: Path, capsys) -> None:
    (tmp_path / "kaggle").mkdir()
    csv(f"{HEADER}\n{lines()}\n")(tmp_path / "kaggle")
    csv("id,label\n", "sample_submission.csv")(tmp_path / "kaggle")
    options = ("--source", "table", "--images", tmp_path / "kaggle", "--split-by", "none")
    assert call("mnist3d", "generate", *options, "--out", tmp_path / "set") == 0
    assert "sample_submission.csv" in capsys.readouterr().err
    card = (tmp_path / "set" / "README.md").read_text()
    assert "`table`: 6 images of 28 x 28 pixels from tables or arrays" in card
    assert "license: other" in card
    assert call("mnist3d", "generate", "--source", "mnist", *options[2:], "--out", tmp_path / "other") == 2
    assert "--source table" in capsys.readouterr().err
