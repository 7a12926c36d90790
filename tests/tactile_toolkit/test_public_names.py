"""Every package provides the public names of its stub, on first use."""

from __future__ import annotations

import ast
import pkgutil
from importlib import import_module
from pathlib import Path

import pytest

import tactile_toolkit

ROOT = Path(tactile_toolkit.__file__).parents[1]
PACKAGES = sorted(
    ".".join(stub.parent.relative_to(ROOT).parts)
    for pattern in ("*/__init__.pyi", "tactile_toolkit/*/__init__.pyi")
    for stub in ROOT.glob(pattern)
)
NEEDS = {"RayRunner", "GraspGenerator"}
"""Names that need a package of an extra."""
TORCH = ("MeshBatch", "MeshItem", "SolidTensors", "TrainingBatches")


@pytest.mark.parametrize("package", PACKAGES)
def test_each_package_has_the_names_of_its_stub(package):
    module = import_module(package)
    stub = ast.parse(Path(str(module.__file__)).with_suffix(".pyi").read_bytes())
    homes = [node for node in stub.body if isinstance(node, ast.ImportFrom) and node.module]
    names = {each.name for node in homes for each in node.names}
    assert set(dir(module)) >= names
    modules = {each.name for each in pkgutil.iter_modules(module.__path__)}
    assert not modules & names, "importing such a module takes the place of the name"
    for name in sorted(names - {*NEEDS, *TORCH, "collate_meshes", "shared_zeros"}):
        assert not isinstance(getattr(module, name), type(pkgutil)), name
    with pytest.raises(AttributeError, match="nothing"):
        _ = module.nothing


@pytest.mark.parametrize("package", [name for name in PACKAGES if "." not in name])
def test_each_product_states_the_version(package):
    assert import_module(package).__version__ == tactile_toolkit.__version__
