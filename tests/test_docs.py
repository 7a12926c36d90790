"""Everything that the documents name exists."""

from __future__ import annotations

import ast
import re
from importlib import import_module
from pathlib import Path

import pytest

from tactile_toolkit.errors import InputError
from tests.inline_code import fault
from tests.pages import inline_code
from tests.test_readme import every_page
from tests.unchanged.record import PACKAGES as PACKAGES_OF_USERS

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = (
    "mnist3d|starstruck_gen|realtouch|tactile_sim|tactile_toolkit|env_assets|tactile_envs|cli|tests|"
    "benchmarks|docs"
)
NAMED = re.compile(rf"(?<![\w./-])((?:{PACKAGES})/[\w./]*)")


def test_files_that_documents_name_exist():
    for document in ("docs/architecture.md", "benchmarks/README.md"):
        named = NAMED.findall((ROOT / document).read_text(encoding="utf-8"))
        assert named
        missing = [name for name in named if not (ROOT / name.rstrip(".")).exists()]
        assert not missing, f"{document} names {missing}"


FOREIGN = {"--array", "--cpus-per-task", "tactile_toolkit.kinds"}
"""Options of Slurm; a group of entry points."""


@pytest.mark.parametrize("page", [*every_page(), "CONTRIBUTING.md"])
def test_commands_options_and_calls_in_the_text_are_there(page):
    faults = {code: fault(code) for code in inline_code(page) if code not in FOREIGN}
    assert {code: wrong for code, wrong in faults.items() if wrong} == {}


@pytest.mark.parametrize(
    "code",
    [
        'AssetProvider("assets", {}, 3)',
        'mnist3d.lood("digits")',
        'mnist3d.load(..., spilt="test")',
        "digits.filter_label(4)",
        "realtouch.tensors",
        "mnist3d genrate",
        "tactile preview --king steps",
        "preview --king steps",
        "--king steps",
        "realtouch stills | resise",
    ],
)
def test_a_false_one_is_found(code):
    assert fault(code)


def modules_of_the_reference() -> list[str]:
    """Modules named in docs/generated.py, which itself cannot be imported without Sphinx."""
    tree = ast.parse((ROOT / "docs/generated.py").read_text(encoding="utf-8"))
    (names,) = [
        node.value
        for node in tree.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "API"
    ]
    return list(ast.literal_eval(names))


def test_every_public_package_is_in_the_reference():
    assert set(PACKAGES_OF_USERS) <= set(modules_of_the_reference())


@pytest.mark.parametrize("name", modules_of_the_reference())
def test_every_module_of_the_reference_has_the_names_that_it_lists(name):
    """The suite finds it before Sphinx does, which runs at the very end of CI."""
    try:
        module = import_module(name)
    except (ImportError, InputError) as error:
        pytest.skip(f"needs an extra: {error}")
    assert set(getattr(module, "__all__", ())) <= set(dir(module))
