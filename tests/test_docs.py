"""What the documents name is there, and what they show runs."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

from typer.testing import CliRunner

from cli.realtouch import app
from tests.realtouch.factories import encode_jpeg, make_round, seq_rows, single_rows, write_set

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = "mnist3d|starstruck_gen|realtouch|tactile_sim|tactile_toolkit|env_assets|cli|tests|benchmarks|docs"
NAMED = re.compile(rf"(?<![\w./-])((?:{PACKAGES})/[\w./]*)")


def test_files_that_documents_name_exist():
    for document in ("docs/architecture.md", "benchmarks/README.md"):
        named = NAMED.findall((ROOT / document).read_text(encoding="utf-8"))
        assert named
        missing = [name for name in named if not (ROOT / name.rstrip(".")).exists()]
        assert not missing, f"{document} names {missing}"


def test_the_page_of_exchange_runs(tmp_path: Path) -> None:
    """Shell lines one after another, then the Python blocks as one script."""
    text = (ROOT / "docs" / "exchange.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```(\w+)\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)
    rounds = [make_round(index, 4, (64, 48)) for index in range(2)]
    write_set(tmp_path / "TOUCHES", {"train": single_rows(rounds)}, "single")
    write_set(tmp_path / "CLIPS", {"train": seq_rows(rounds)}, "seq")
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "a.jpg").write_bytes(encode_jpeg(rounds[0].touches[0].pixels[0]))
    table = "file,digit,x,y,z,qx,qy,qz,qw\na.jpg,7,0,0,0.01,0,0,0,1\n"
    (tmp_path / "pictures" / "index.csv").write_text(table)
    lines = [line for kind, block in blocks if kind == "bash" for line in block.splitlines()]
    assert len(lines) == 5
    home = Path.cwd()
    os.chdir(tmp_path)
    try:
        for line in lines:
            command, *arguments = shlex.split(line)
            assert command == "realtouch"
            done = CliRunner().invoke(app, [*arguments, "--workers", "1"])
            assert done.exit_code == 0, (line, done.output)
    finally:
        os.chdir(home)
    script = "\n".join(block for kind, block in blocks if kind == "python")
    ran = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", script],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.splitlines()[-1] == "1 7 (48, 64, 3)"
