"""Inner changes must not reach users: the recorded bytes, names and help texts are still what they were."""

from __future__ import annotations

import json
from dataclasses import is_dataclass
from importlib import import_module

import pytest

from tests.unchanged.record import (
    COMMAND_LINES,
    FOLDER,
    HELP_LIBRARIES,
    PACKAGES,
    begin_as_first_version,
    data_sets,
    defaults_and_limits,
    help_of_commands,
    helps,
    library_versions,
    pictures,
    public_names,
    synthetic_touches,
)

RECORD = json.loads((FOLDER / "record.json").read_text(encoding="utf-8"))
FIRST_VERSION = json.loads((FOLDER / "first_version.json").read_text(encoding="utf-8"))
"""Digests of the same sets of the first version of the schema, which is never recorded again."""


NEEDED = {"realtouch.torch": "torch", "env_assets": "tactile_mnist"}


@pytest.mark.parametrize("package", PACKAGES)
def test_public_names_are_unchanged(package):
    if package == "realtouch.torch":
        pytest.importorskip("torch", reason="needs torch, of the extra torch")
    assert public_names(package) == RECORD["names"][package]


@pytest.mark.parametrize("package", PACKAGES)
def test_defaults_and_limits_are_unchanged(package):
    """Of all public names, some of which only extras can import."""
    if package in NEEDED:
        pytest.importorskip(NEEDED[package], reason=f"needs {NEEDED[package]}, of an extra")
    assert defaults_and_limits(package) == RECORD["fields"][package]


@pytest.mark.parametrize("package", PACKAGES)
def test_what_users_hold_is_not_changed_by_whoever_else_holds_it(package):
    if package in NEEDED:
        pytest.importorskip(NEEDED[package], reason=f"needs {NEEDED[package]}, of an extra")
    held = [getattr(import_module(package), name) for name in public_names(package)]
    kinds = [kind for kind in held if isinstance(kind, type) and is_dataclass(kind)]
    # An error is not held; Python itself writes where it came from into it.
    changeable = [kind for kind in kinds if not kind.__dataclass_params__.frozen]
    assert all(issubclass(kind, Exception) for kind in changeable), changeable


def test_every_package_is_recorded():
    assert set(RECORD["names"]) == set(PACKAGES)


@pytest.mark.parametrize("command_line", COMMAND_LINES)
def test_help_is_unchanged_and_names_no_former_spelling_or_type_of_python(command_line):
    found = help_of_commands(command_line)
    for name, text in found.items():
        for word in ("<bool>", "<int range>", "<float>", "<float range>", " --layout", " --gap ", " --bed"):
            assert not name or word not in text, (name, word)
        assert "Example" in text or name in ("", "upload", "download"), name
    if library_versions(HELP_LIBRARIES) != RECORD["help_libraries"]:
        pytest.skip(f"help is laid out by libraries; recorded with {RECORD['help_libraries']}")
    assert helps(found) == (FOLDER / f"{command_line}.txt").read_text(encoding="utf-8")


def test_bytes_of_data_sets_and_their_pictures_are_unchanged(tmp_path):
    if library_versions() != RECORD["libraries"]:
        pytest.skip(f"bytes follow from the versions of libraries; recorded with {RECORD['libraries']}")
    assert data_sets(tmp_path / "new") == RECORD["parquet"]
    assert pictures(tmp_path / "new") == RECORD["pictures"]
    begin_as_first_version(tmp_path / "new", tmp_path / "first")
    assert data_sets(tmp_path / "first") == FIRST_VERSION["parquet"]


@pytest.mark.sim
def test_bytes_of_synthetic_touches_are_unchanged(tmp_path):
    pytest.importorskip("taxim", reason="needs taxim, of the extra sim")
    if library_versions() != RECORD["libraries"]:
        pytest.skip(f"bytes follow from the versions of libraries; recorded with {RECORD['libraries']}")
    assert synthetic_touches(tmp_path / "new") == RECORD["touches"]
    begin_as_first_version(tmp_path / "new", tmp_path / "first", "touches-*")
    assert synthetic_touches(tmp_path / "first") == FIRST_VERSION["touches"]
