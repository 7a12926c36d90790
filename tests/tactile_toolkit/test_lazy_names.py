from __future__ import annotations

from importlib import import_module

import pytest

import tactile_toolkit


@pytest.mark.parametrize(
    "package", ["env_assets", "mnist3d", "realtouch", "starstruck_gen", "tactile_envs", "tactile_sim"]
)
def test_each_package_lists_its_public_names_and_the_version(package):
    module = import_module(package)
    assert dir(module) == sorted(module.__all__)
    assert module.__version__ == tactile_toolkit.__version__
    with pytest.raises(AttributeError, match=f"module '{package}' has no attribute 'nothing'"):
        _ = module.nothing
