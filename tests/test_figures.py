"""Figures in the documents equal those of the benchmarks; those of changed code are known."""

from __future__ import annotations

import json
import re
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
def test_figures_are_written_by_the_script() -> None:
    """Figures are not edited by hand."""
    for document in figures.DOCUMENTS:
        text = document.read_text(encoding="utf-8")
        assert text == figures.written(text, results()), f"{document}; next: run benchmarks/run --write"
        # At the beginning of a line, such a comment would end the paragraph.
        assert re.search(r"^<!-- figures: \S+\.", text, re.MULTILINE) is None, document


def test_a_figure_in_a_sentence_is_written_in_words() -> None:
    figure = {"name": "nodes", "value": 0.0123, "unit": "s", "plain": 0.1, "plain_name": "one worker"}
    figure |= {"what": "two nodes", "statistic": "median of 3", "limit": 0.001, "limit_name": "a copy"}
    known = {"scale": {"figures": [figure], "machine": "", "date": "", "versions": {}, "code": ""}}
    text = "It takes <!-- figures: scale.nodes -->1 h<!-- end -->."
    assert figures.written(text, known) == "It takes <!-- figures: scale.nodes -->12.3 ms<!-- end -->."
    with pytest.raises(KeyError):
        figures.written(text.replace("nodes", "clouds"), known)
    row = "two Ray nodes | 12.3 ms, median of 3 |  |  | 100 ms: one worker | **8.13** | 1 ms: a copy |"
    assert row in dict(figures.tables(known))["all"]


@pytest.mark.parametrize(
    ("target", "is_met"), [("at least 8", True), ("at least 9", False), ("at most 9", True), ("", True)]
)
def test_a_target_is_of_the_first_ratio(target: str, is_met: bool) -> None:
    figure = {"value": 2.0, "published": 17.0, "plain": 100.0} | ({"target": target} if target else {})
    assert figures.is_met(figure) == is_met


def test_every_table_has_its_place() -> None:
    text = "".join(document.read_text(encoding="utf-8") for document in figures.DOCUMENTS)
    for name, _ in figures.tables(results()):
        assert f"<!-- figures: {name} -->" in text
    assert set(results()) == set(figures.BENCHMARKS)


def test_code_changes_make_figures_old_and_comments_do_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(figures, "ROOT", tmp_path)
    monkeypatch.setitem(figures.BENCHMARKS, "code", ("code.py",))
    code = tmp_path / "code.py"
    code.write_text('"""Text."""\n\ndef f():\n    """More."""\n    return 1\n')
    before = figures.fingerprint(("code.py",))
    code.write_text("def f():\n    # why\n    return 1\n")
    assert not figures.aged({"code": {"code": before}})
    code.write_text("def f():\n    return 2\n")
    assert figures.aged({"code": {"code": before}}) == ["code"]
