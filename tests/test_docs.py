"""What the documents name is there."""

from __future__ import annotations

import re
from pathlib import Path

from tests.unchanged.record import PACKAGES as PACKAGES_OF_USERS

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = "mnist3d|starstruck_gen|realtouch|tactile_sim|tactile_toolkit|env_assets|cli|tests|benchmarks|docs"
NAMED = re.compile(rf"(?<![\w./-])((?:{PACKAGES})/[\w./]*)")


def test_files_that_documents_name_exist():
    for document in ("docs/architecture.md", "benchmarks/README.md"):
        named = NAMED.findall((ROOT / document).read_text(encoding="utf-8"))
        assert named
        missing = [name for name in named if not (ROOT / name.rstrip(".")).exists()]
        assert not missing, f"{document} names {missing}"


def test_every_public_package_is_in_the_reference():
    written = (ROOT / "docs/generated.py").read_text(encoding="utf-8")
    assert [package for package in PACKAGES_OF_USERS if f'"{package}"' not in written] == []
