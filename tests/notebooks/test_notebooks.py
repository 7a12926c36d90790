"""The notebooks run from top to bottom without a network, and give their stored output."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.notebooks.running import NOTEBOOKS, clips, run

LARGEST_BYTES = 200_000


@pytest.fixture
def offline(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return tmp_path


def words(outputs: list[dict]) -> list[str]:
    """Return the output of a cell without pictures, whose bytes depend on versions of libraries."""
    return ["".join(shown.get("text") or shown["data"]["text/plain"]) for shown in outputs]


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["digits", "realtouch"])
def test_notebooks_give_their_stored_output(name, offline, monkeypatch):
    monkeypatch.setenv("REALTOUCH_SET", str(clips(offline / "clips")))
    notebook = NOTEBOOKS / f"{name}.ipynb"
    cells = [cell for cell in json.loads(notebook.read_text())["cells"] if cell["cell_type"] == "code"]
    shown, _ = run(notebook)
    for cell, outputs in zip(cells, shown, strict=True):
        assert words(cell["outputs"]) == words(outputs), "python -m tests.unchanged.record stores them"
        pictures = [set(each.get("data", ())) for each in outputs]
        assert [set(each.get("data", ())) for each in cell["outputs"]] == pictures
    assert any("image/png" in output.get("data", ()) for cell in cells for output in cell["outputs"])
    assert notebook.stat().st_size < LARGEST_BYTES


@pytest.mark.thorough
def test_a_set_without_any_contact_is_walked_through_too(offline, monkeypatch):
    monkeypatch.setenv("REALTOUCH_SET", str(clips(offline / "clips", contact=False)))
    shown, names = run(NOTEBOOKS / "realtouch.ipynb")
    assert "10 touches, 0 met the object\n" in [word for outputs in shown for word in words(outputs)]
    assert len(names["contacts"]) == 0
    assert np.shape(names["images"][0].sensor_image[:]) == (5, 72, 96, 3)
