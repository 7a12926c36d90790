"""Internal changes must not affect users: bytes and names are the recorded ones."""

from __future__ import annotations

import re
from dataclasses import is_dataclass
from importlib import import_module
from pathlib import Path

import pytest

from tests.env_assets.conftest import assets  # noqa: F401
from tests.unchanged import environments
from tests.unchanged.record import (
    OUR_PACKAGES,
    PACKAGES,
    data_sets,
    defaults_and_limits,
    importable,
    library_versions,
    numbers_of,
    pictures,
    public_names,
    recorded,
    styles,
    synthetic_touches,
)

RECORD = recorded()


UNFROZEN = re.compile(r"^@dataclass\b(?!.*frozen=True).*\n(?:@.*\n)*class (\w+)", re.MULTILINE)
CHANGING = {"_Training", "DiskCache", "_Object", "_Row", "MeshPool", "Section", "Fit", "Topic", "Steps"}
"""Dataclasses that change: a training, a cache, part of a file, a row of a plate, a growing pool, a check, a
fit, a topic whose messages are read, progress."""


@pytest.mark.parametrize("package", PACKAGES)
def test_public_names_are_unchanged(package):
    if package == "realtouch.touch_tensors":
        pytest.importorskip("torch", reason="needs torch, of the extra torch")
    assert public_names(package) == RECORD["names"][package]


@pytest.mark.parametrize("package", PACKAGES)
def test_defaults_and_limits_are_unchanged(package):
    """Of all public names, except those that need extras."""
    if package == "realtouch.touch_tensors":
        pytest.importorskip("torch", reason="needs torch, of the extra torch")
    names = importable(package)
    fields = RECORD["fields"][package].items()
    expected = {place: default for place, default in fields if re.split(r"[.(]", place)[0] in names}
    assert defaults_and_limits(package) == expected
    assert expected


@pytest.mark.parametrize("package", PACKAGES)
def test_shared_values_cannot_be_changed(package):
    if package == "realtouch.touch_tensors":
        pytest.importorskip("torch", reason="needs torch, of the extra torch")
    kinds = [kind for kind in importable(package).values() if isinstance(kind, type) and is_dataclass(kind)]
    # Errors are not cached; Python itself writes their traceback into them.
    changeable = [kind for kind in kinds if not kind.__dataclass_params__.frozen]
    assert all(issubclass(kind, Exception) for kind in changeable), changeable


def test_dataclasses_are_frozen():
    """Also those inside packages, because modules read each other's values."""
    found = {
        name
        for package in OUR_PACKAGES | {"cli"}
        for file in Path(import_module(package).__file__).parent.rglob("*.py")
        for name in UNFROZEN.findall(file.read_text(encoding="utf-8"))
    }
    assert found == CHANGING


def test_every_package_is_recorded():
    assert set(RECORD["names"]) == set(PACKAGES)


def test_how_shards_are_stored_is_unchanged():
    assert styles() == RECORD["styles"]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Small data sets of each kind, and the digests of their files."""
    if library_versions() != RECORD["libraries"]:
        pytest.skip(f"bytes follow from the versions of libraries; recorded with {RECORD['libraries']}")
    folder = tmp_path_factory.mktemp("sets")
    return folder, data_sets(folder)


def test_bytes_of_data_sets_and_their_pictures_are_unchanged(made):
    folder, digests = made
    assert digests == RECORD["parquet"]
    assert pictures(folder) == RECORD["pictures"]


@pytest.mark.sim
def test_bytes_of_synthetic_touches_are_unchanged(tmp_path):
    pytest.importorskip("taxim", reason="needs taxim, of the extra sim")
    if library_versions() != RECORD["libraries"]:
        pytest.skip(f"bytes follow from the versions of libraries; recorded with {RECORD['libraries']}")
    assert synthetic_touches(tmp_path) == RECORD["touches"]


@pytest.mark.envs
def test_settings_of_environments_are_unchanged():
    assert environments.ids() == RECORD["environments"]


@pytest.mark.one_at_a_desk
@pytest.mark.envs
@pytest.mark.parametrize("name", environments.COURSES)
def test_courses_of_environments_are_unchanged(name, assets):  # noqa: F811
    """Other tests compare them with the published environments, which only CI can do."""
    pytest.importorskip("ap_gym", reason="ap-gym (extra `envs`) is not installed")
    found, course = environments.course(name, assets), RECORD["courses"][name]
    assert found.keys() == course.keys()
    for key, values in found.items():
        loose = {"abs": 0.3} if key.startswith("picture") else {"rel": 2e-5, "abs": 1e-6}
        assert values == pytest.approx(numbers_of(course[key]), **loose), key
