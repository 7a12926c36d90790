"""Data sets with only pictures, as imports of recordings make them: every command accepts them."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import realtouch
from tactile_toolkit.errors import InputError
from tests.command_line import call
from tests.realtouch import factories

KINDS = ("single", "seq")
LABELS = (None, -1)
"""Without the column, and with the value that imports give to touches without a class."""

EXPORTS = ("flat", "webdataset", "lerobot", "replay", "oxt", "fota")
_TRAIN = ["--split", "train"]
COMMANDS: dict[str, list[str]] = {
    "load": ["realtouch", "load", "SET", *_TRAIN],
    "info": ["tactile", "info", "SET"],
    "verify": ["tactile", "verify", "SET"],
    "show": ["tactile", "show", "SET"],
    "preview": ["tactile", "preview", "SET", *_TRAIN, "--draw", "all", "--out", "OUT"],
    "gallery": ["tactile", "gallery", "SET", "--out", "OUT"],
    "card": ["tactile", "card", "SET"],
    "split": ["tactile", "split", "SET", "--fractions", "0.5", "--out", "OUT"],
    "merge": ["tactile", "merge", "SET", "OTHER", "--out", "OUT"],
    "select": ["tactile", "select", "SET", "--contact", "--out", "OUT"],
    "select ids": ["tactile", "select", "SET", "--limit", "1", "--out", "OUT"],
    "resize": ["realtouch", "resize", "SET", "--size", "32x24", "--out", "OUT"],
    "frames": ["tactile", "export", "SET", "--format", "png", "--out", "OUT"],
    "stills": ["realtouch", "stills", "SET", "--out", "OUT"],
    "stills best": ["realtouch", "stills", "SET", "--clip-frame", "best", "--out", "OUT"],
    **{
        f"export {each}": ["tactile", "export", "SET", *_TRAIN, "--format", each, "--out", "OUT"]
        for each in EXPORTS
    },
}


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, int | None], Path]:
    """Return the folder of a set of a kind, with a label or without that column."""
    home = tmp_path_factory.mktemp("bare")
    for kind in KINDS:
        for label in LABELS:
            for name in ("set", "other"):
                factories.bare_set(home / f"{kind}-{label}-{name}", kind, label, prefix=name)
    return lambda kind, label: home / f"{kind}-{label}-set"


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("label", [None, pytest.param(-1, marks=pytest.mark.thorough)])
@pytest.mark.parametrize("kind", KINDS)
def test_every_command_accepts_a_set_with_only_pictures(kind, label, name, sets, tmp_path, capsys):
    if kind == "single" and name.startswith("stills"):
        pytest.skip("converts clips")
    folder = sets(kind, label)
    if name == "card":
        folder = Path(shutil.copytree(folder, tmp_path / "copy"))
    places = {"SET": folder, "OTHER": f"{str(folder)[: -len('set')]}other", "OUT": tmp_path / "out"}
    code = call(*(places.get(word, word) for word in COMMANDS[name]))
    said = capsys.readouterr()
    assert code == 0, said.err
    if "OUT" in COMMANDS[name] and name not in ("preview", "gallery", "split"):
        assert call("tactile", "verify", tmp_path / "out") == 0, capsys.readouterr().err


@pytest.mark.parametrize("kind", KINDS)
def test_contact_is_decided_by_pictures_without_poses(kind: str, sets: Any, tmp_path: Path) -> None:
    touches = realtouch.load(sets(kind, -1), "train").touches()
    by_image = realtouch.contacts_by_image(touches).contact
    np.testing.assert_array_equal(touches.in_contact(), by_image)
    assert touches.with_contact() == touches[by_image]
    with pytest.raises(InputError, match=r"no column 'gel_pose_cell_frame.*leave out the height"):
        touches.with_contact(0.006)
    rule = realtouch.summarise(touches.dataset).contact_rule
    manifest = realtouch.select(sets(kind, -1), tmp_path / "out", contact=True, split="train")
    assert manifest.spec["options"]["contact_rule"] == rule
    assert "the picture differs from the background" in rule
    assert "plate_z_m" not in realtouch.load(tmp_path / "out", "train").column_names


def test_operations_that_need_an_absent_column_name_it(sets: Any, tmp_path: Path) -> None:
    clips, out = sets("seq", -1), str(tmp_path / "out")
    record = realtouch.load(clips, "train")[0]
    others = "which 'peak' needs; next: choose the frame by one of contact_start, contact_end, best"
    for ask in (
        lambda: record.contact_frames("peak"),
        lambda: realtouch.clips_to_images(clips, out, "peak"),
        lambda: realtouch.export(clips, out, "png", frame="peak"),
        lambda: realtouch.export(clips, out, "flat", frame="peak"),
    ):
        with pytest.raises(InputError, match=f"no column 'gel_pose_cell_frame_seq.position', {others}"):
            ask()
    for label in LABELS:
        for choice in ({"labels": ["3"]}, {"per_class": 2}):
            with pytest.raises(InputError, match=r"have no labels, .*; next: choose by --ids, or import"):
                realtouch.select(sets("single", label), out, **choice)
        with pytest.raises(InputError, match="no class 3; the data set has no labels"):
            realtouch.load(sets("seq", label), "train").filter_labels(3)
        assert call("tactile", "gallery", sets("seq", label), "--labels", "3", "--out", out) == 2
    with pytest.raises(InputError, match="no column 'object_id'"):
        realtouch.select(clips, out, ids=[3])
    assert not (tmp_path / "out").exists()


def test_contact_of_a_round_that_does_not_fit_in_memory(sets: Any, monkeypatch: Any) -> None:
    for kind in KINDS:
        touches = realtouch.load(sets(kind, -1), "train").touches()
        whole = realtouch.contacts_by_image(touches)
        monkeypatch.setattr("realtouch.touches.image_contacts._BATCH_BYTES", 2 * 36 * 48 * 3)
        parts = realtouch.contacts_by_image(touches)
        monkeypatch.undo()
        for name in ("frame", "area_px", "intensity", "contact"):
            np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))
