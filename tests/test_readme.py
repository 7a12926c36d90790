"""Everything in README and in the pages of the site runs, against a Hub on 127.0.0.1."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.hub_server import hub
from tests.pages import ROOT, blocks, commands
from tests.realtouch.factories import make_round, single_rows, write_set

PUBLISHED = "TimSchneider42/tactile-mnist-touch-real-single-t256-64x64"
PAGES = (
    "docs/tour.md",
    "docs/touches.md",
    "docs/elastic.md",
    "docs/concepts/folder.md",
    "docs/howto/picture.md",
    "docs/howto/print.md",
    "docs/howto/handwriting.md",
    "docs/howto/scenes.md",
    "docs/howto/training.md",
    "docs/howto/export.md",
    "docs/howto/import.md",
    "docs/howto/check.md",
    "docs/howto/your_sensor.md",
    "docs/howto/twin.md",
    "docs/howto/forces.md",
    "docs/elastic.md",
    "docs/howto/libraries.md",
    "docs/howto/environments.md",
    "docs/howto/policies.md",
    "docs/howto/own_task.md",
    "docs/howto/train_agent.md",
    "docs/howto/simulators.md",
    "docs/howto/mujoco.md",
    "docs/howto/hub.md",
    "docs/paper.md",
    "docs/learned.md",
    "docs/howto/training_libraries.md",
)
"""In the order in which a reader meets them; the tour makes what others use.

The page of libraries is the last: TorchRL changes how processes of Python begin.
"""

NOT_RUN = ("docs/operators.md", "docs/install.md")
"""Pages whose code needs clusters, or installs."""

NEEDED = {
    "envs": "ap_gym",
    "film": "moviepy",
    "libraries": "torchrl",
    "loaders": "grain",
    "mujoco": "mujoco",
    "oracle": "tactile_mnist",
    "torch": "torchdata",
}
"""A package of each extra that blocks name."""


@pytest.fixture(scope="module")
def surroundings(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, dict[str, str]]]:
    """Give a folder to work in, and settings for a Hub that holds a small set by its published name."""
    base = tmp_path_factory.mktemp("readme")
    rounds = [make_round(index, 256, (64, 64)) for index in range(4)]
    write_set(base / "hub" / PUBLISHED, {"test": single_rows(rounds)}, "single")
    with hub(base / "hub") as server:
        yield (
            base,
            {
                "HF_ENDPOINT": server.endpoint,
                "HF_HOME": str(base / "hf"),
                "HF_TOKEN": server.account("YOU"),
                "HF_HUB_DISABLE_XET": "1",
                "OMP_NUM_THREADS": "1",  # next to other tests, threads mostly wait for each other
                "PYTHONPATH": str(ROOT),
                "TACTILE_TOOLKIT_CACHE": str(base / "cache"),
            },
        )


def run(program: list[str], surroundings: tuple[Path, dict[str, str]], folder: str) -> None:
    base, settings = surroundings
    (base / folder).mkdir(exist_ok=True)
    done = subprocess.run(
        program, cwd=base / folder, env=os.environ | settings, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{program}\n{done.stdout}{done.stderr}"


def every_page() -> list[str]:
    found = [path.relative_to(ROOT).as_posix() for path in sorted((ROOT / "docs").rglob("*.md"))]
    return ["README.md", *(page for page in found if not page.startswith("docs/_"))]


def test_blocks_are_of_known_kinds():
    assert {block.language for block in blocks("README.md")} <= {"bash", "python", "text"}
    shell = [block.text for block in blocks("README.md") if block.language == "bash"]
    set_up = [line for text in shell for line in commands(text) if "pip install" in line]
    assert [line.partition(" && ")[0] for line in set_up] == ["python3 -m venv .venv"] * 2
    named = {block.extra for page in every_page() for block in blocks(page)} - {None}
    assert named == set(NEEDED)


@pytest.mark.thorough
def test_readme_runs(surroundings):
    """As a reader would type it; CI runs the two lines that install."""
    run([sys.executable, "-m", "tests.pages", "README.md"], surroundings, "readme")


@pytest.mark.thorough
@pytest.mark.envs
def test_the_block_with_environments_runs(surroundings):
    pytest.importorskip("ap_gym", reason="needs ap-gym, of the extra envs")
    (block,) = [block for block in blocks("README.md") if block.extra == "envs"]
    run([sys.executable, "-c", block.text], surroundings, "environments")


@pytest.mark.thorough
def test_pages_of_the_site_run(surroundings):
    """One reader goes through all of them in one folder; blocks whose extra is not there are left out."""
    extras = [extra for extra, package in NEEDED.items() if find_spec(package)]
    assert not os.environ.get("REQUIRE_EXTRAS") or len(extras) == len(NEEDED)
    run([sys.executable, "-m", "tests.pages", *PAGES, *extras], surroundings, "site")


def test_every_page_with_code_runs():
    code = ("bash", "python")
    with_code = {page for page in every_page() if any(block.language in code for block in blocks(page))}
    assert with_code - set(NOT_RUN) == {"README.md", *PAGES}


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", *every_page()])
def test_links_lead_to_files_of_a_checkout(page):
    """What the site generates is named in directives, which are no links."""
    for target in re.findall(r"\]\(([^)#\s]+)", (ROOT / page).read_text(encoding="utf-8")):
        if ":" not in target:
            assert ((ROOT / page).parent / target).exists(), target
