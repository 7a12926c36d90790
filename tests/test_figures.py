"""Figures in the documents equal those of the benchmarks; figures of changed code are marked."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "benchmarks"))
import figures  # noqa: E402


def results() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(figures.RESULTS.read_text(encoding="utf-8"))
    return found


@pytest.mark.thorough
@pytest.mark.parametrize("document", figures.DOCUMENTS, ids=lambda path: path.parent.name)
def test_tables_are_written_by_the_script(document: Path) -> None:
    """Figures are not edited by hand; ``benchmarks/run --write`` marks what is older than its code."""
    text = document.read_text(encoding="utf-8")
    assert text == figures.written(text, results()), "next: run benchmarks/run --write"


def test_every_table_has_its_place() -> None:
    text = "".join(document.read_text(encoding="utf-8") for document in figures.DOCUMENTS)
    for name, _ in figures.tables(results()):
        assert f"<!-- figures: {name} -->" in text
    assert set(results()) == set(figures.BENCHMARKS)


def test_code_changes_mark_and_comments_do_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(figures, "ROOT", tmp_path)
    code = tmp_path / "code.py"
    code.write_text('"""Text."""\n\ndef f():\n    """More."""\n    return 1\n')
    before = figures.fingerprint(("code.py",))
    code.write_text("def f():\n    # why\n    return 1\n")
    assert figures.fingerprint(("code.py",)) == before
    code.write_text("def f():\n    return 2\n")
    assert figures.fingerprint(("code.py",)) != before
