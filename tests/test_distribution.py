"""Distributions: the wheel contains only the packages, the sdist only the checkout."""

from __future__ import annotations

import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def tracked() -> set[str]:
    """Return the files that git tracks or will track, by path in the checkout."""
    listing = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", "--deduplicate"]
    done = subprocess.run(listing, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip("not a git checkout, so nothing says which files belong to it")
    return {name for name in done.stdout.split("\0") if name and (ROOT / name).exists()}


@pytest.fixture(scope="module")
def packed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dist")
    build = [sys.executable, "-m", "hatchling", "build", "-d", str(folder)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    return folder


@pytest.mark.thorough
def test_the_sdist_holds_the_checkout(packed: Path) -> None:
    (file,) = packed.glob("*.tar.gz")
    with tarfile.open(file) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert names - {"PKG-INFO"} == tracked()


@pytest.mark.thorough
def test_the_wheel_holds_the_packages(packed: Path) -> None:
    (file,) = packed.glob("*.whl")
    names = zipfile.ZipFile(file).namelist()
    about = {name.partition("/")[2] for name in names if name.split("/")[0].endswith(".dist-info")}
    packages = {path.parent.name for path in ROOT.glob("*/__init__.py")} - {"tests"} | {"data_cards"}
    of_packages = {name for name in tracked() if name.split("/")[0] in packages}
    assert {name for name in names if ".dist-info/" not in name} == of_packages
    assert about >= {"METADATA", "RECORD", "entry_points.txt", "licenses/LICENSE"}
    # Fonts and templates are no modules, and are what a wheel forgets.
    assert {Path(name).suffix for name in names} >= {".py", ".ttf", ".typed"}
