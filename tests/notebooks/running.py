"""Run notebooks without Jupyter, and store their output: ``python -m tests.notebooks.running``."""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
import os
import re
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

from tests.realtouch.factories import make_round, seq_rows, write_set

NOTEBOOKS = Path(__file__).parents[2] / "notebooks"


def run(notebook: Path) -> tuple[list[list[dict[str, Any]]], dict[str, Any]]:
    """Return the output of each code cell, as a notebook stores it, and the names at the end."""
    names: dict[str, Any] = {}
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    codes = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    return [_run_cell(code, names, number) for number, code in enumerate(codes, 1)], names


def _run_cell(source: str, names: dict[str, Any], number: int) -> list[dict[str, Any]]:
    body = ast.parse(source).body
    last = ast.Expression(body.pop().value) if isinstance(body[-1], ast.Expr) else None
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(ast.Module(body, []), f"cell {number}", "exec"), names)
        value = eval(compile(last, f"cell {number}", "eval"), names) if last else None
    shown: list[dict[str, Any]] = []
    if printed.getvalue():
        shown.append({"output_type": "stream", "name": "stdout", "text": _lines(printed.getvalue())})
    if value is not None:
        data: dict[str, Any] = {"text/plain": _lines(re.sub(r" at 0x[0-9A-Fa-f]+", "", repr(value)))}
        if hasattr(value, "_repr_html_"):
            data["text/html"] = _lines(value._repr_html_())
        if hasattr(value, "_repr_png_"):
            data["image/png"] = base64.b64encode(value._repr_png_()).decode()
        shown.append(
            {"output_type": "execute_result", "execution_count": number, "metadata": {}, "data": data}
        )
    return shown


def _lines(text: str) -> list[str]:
    return text.splitlines(keepends=True)


def record(notebook: Path) -> None:
    """Write the output of the cells of a notebook into it."""
    content = json.loads(notebook.read_text(encoding="utf-8"))
    codes = [cell for cell in content["cells"] if cell["cell_type"] == "code"]
    for number, (cell, outputs) in enumerate(zip(codes, run(notebook)[0], strict=True), 1):
        cell.update(execution_count=number, outputs=outputs)
    notebook.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def clips(folder: Path, *, contact: bool = True) -> Path:
    """Write a small made-up set of clips."""
    rounds = [make_round(index, 6 if contact else 15, (96, 72)) for index in range(2)]
    if not contact:
        rounds = [
            replace(
                each,
                touches=[touch for touch in each.touches if not touch.on_digit],
                pos_in_cell_m=each.pos_in_cell_m[[not touch.on_digit for touch in each.touches]],
            )
            for each in rounds
        ]
    return write_set(folder, {"test": seq_rows(rounds)}, "seq")


def main() -> None:
    """Record all notebooks."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        clips(Path("clips"))
        os.environ["REALTOUCH_SET"] = "clips"
        for notebook in sorted(NOTEBOOKS.glob("*.ipynb")):
            record(notebook)


if __name__ == "__main__":
    main()
