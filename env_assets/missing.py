"""Assets that are not there: made from the embedded sources on first use, or named with what makes them."""

from __future__ import annotations

import contextlib
import json
import logging
import operator
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from env_assets.wrench.kind import KIND as WRENCH
from mnist3d.kind import KIND as DIGITS
from starstruck_gen.kind import KIND as SCENES
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.run.system import locked
from tactile_toolkit.store.files import named_failures
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import read_manifest

if TYPE_CHECKING:
    from tactile_toolkit.making import Recipe


KINDS: dict[str, DatasetKind] = {kind.name: kind for kind in (DIGITS, SCENES, WRENCH)}
"""Assets that the toolkit can make without any input, by name."""

FOREIGN: dict[str, str] = {
    "abc": "CAD models of the ABC data set; the published selection is "
    "TimSchneider42/tactile-mnist-abc-dataset-small on the Hub",
    "minecraft": "items that the package shapes from textures on Mojang's servers, not to be passed on",
}
"""Assets that this toolkit does not make, and where the published ones are from."""

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class AssetMaker:
    """Makes assets in a folder, each kind in a folder of its name.

    The folder of a kind is filled split by split. What an interrupted process has finished is kept by the
    next one. Processes that want the same assets at once wait for the first of them; the system lets the
    next one in should that one die.
    """

    root: Path
    seed: int = 0
    per_class: int | None = None
    workers: int = 1

    def __post_init__(self) -> None:
        """Refuse numbers that nothing can be made of, before anything is asked for."""
        require_integer("seed", self.seed, 0)
        require_integer("workers", self.workers, 1)
        if self.per_class is not None:
            require_integer("per_class", self.per_class, 1)

    def place(self, kind: str) -> Path:
        """Return the folder of a kind."""
        return self.root / kind

    def require_split(self, kind: str, split: str) -> None:
        """Refuse a split that a kind does not have."""
        known = self._recipe(kind).splits
        if split not in known:
            raise InputError(f"unknown split {split!r} of {kind}; expected one of {', '.join(known)}")

    def next_step(self, kind: str, split: str) -> str:
        """Return the next step of a message about a split that is not there: how to make it.

        Raises IntegrityError when the manifest of the folder is damaged.
        """
        # What the message says must work when it is typed: a folder with other settings would refuse ours.
        recipe, folder = self._recipe(kind), self.place(kind)
        manifest = read_manifest(DataFolder(str(folder))) if folder.is_dir() else None
        # Through JSON, which makes lists of tuples: only so are equal specifications equal.
        if manifest is None or manifest.spec == json.loads(json.dumps(recipe.making.manifest())):
            out = f"--out {shlex.quote(str(folder))}"
            command = " ".join(filter(None, (KINDS[kind].made_by, recipe.arguments(split), out)))
            return f"run `{command}`, or make the AssetProvider with generate=True"
        return (
            "that folder was made with settings of its own: run the command that made it again, with "
            f"`--split {split}`, or give the AssetProvider another root"
        )

    def _recipe(self, kind: str) -> Recipe:
        recipe: Recipe = KINDS[kind].recipe(self.seed, self.per_class)
        return recipe

    @contextlib.contextmanager
    def lock(self, kind: str) -> Iterator[None]:
        """Wait for other processes of this machine that make assets of a kind here, and exclude them."""
        # Stays for good: were it removed, two processes could each hold a file of that name.
        file = self.root / f".{kind}.lock"
        with named_failures(str(file)):
            self.root.mkdir(parents=True, exist_ok=True)
            file.touch()
        with locked(file):
            yield

    def make(self, kind: str, split: str) -> None:
        """Make one split of a kind, from where an interrupted run stopped."""
        _LOG.info("making split %r of %s in %s", split, kind, self.place(kind))
        self.require_split(kind, split)
        self._recipe(kind).make(str(self.place(kind)), split, self.workers)


def require_integer(name: str, value: Any, least: int) -> None:
    """Refuse what is not an integer, or too small."""
    try:
        fits = operator.index(value) >= least
    except TypeError:
        fits = False
    if not fits:
        raise InputError(f"{name} of the AssetProvider is {value!r}; expected an integer of at least {least}")
