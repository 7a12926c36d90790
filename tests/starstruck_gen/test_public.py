from __future__ import annotations

import pkgutil
import subprocess
import sys

import pytest

import starstruck_gen


def test_every_public_name_is_there():
    for name in starstruck_gen.__all__:
        assert getattr(starstruck_gen, name) is not None
    assert dir(starstruck_gen) == sorted(starstruck_gen.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = starstruck_gen.nothing


def test_no_public_name_is_hidden_by_a_module():
    """A submodule of the same name would take the place of a function once something imports it."""
    modules = {module.name for module in pkgutil.iter_modules(starstruck_gen.__path__)}
    assert {"scene", "make"} <= modules
    assert not modules & set(starstruck_gen.__all__)


def test_import_brings_no_heavy_library():
    heavy = "{'numpy', 'pyarrow', 'manifold3d', 'trimesh', 'datasets', 'scipy', 'PIL'}"
    code = f"import sys, starstruck_gen; assert not {heavy} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
