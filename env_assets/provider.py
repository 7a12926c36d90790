"""The provider: assets by name, from a folder, from the Hub, or made on first use."""

from __future__ import annotations

import re
from collections.abc import Mapping
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np
from numpy.typing import NDArray

from env_assets.checks import require_kind, require_scene
from env_assets.mesh_sets import DigitMeshes, MeshSet, SceneMeshes, WrenchMeshes, open_meshes
from env_assets.mesh_view import MeshView, mesh_bounds_m
from env_assets.missing import FOREIGN, KINDS, AssetMaker, require_integer
from tactile_toolkit.cache import MemoryCache
from tactile_toolkit.catalog.locate import find_shards
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.mesh.height_map import HeightMap, top_surface
from tactile_toolkit.mesh.mesh import as_mesh
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.store.files import expanded, is_there
from tactile_toolkit.wording import did_you_mean

if TYPE_CHECKING:
    from realtouch.dataset import TouchSeqDataset, TouchSingleDataset
    from starstruck_gen.placement import Placement


_REPOSITORY = re.compile(r"(?:hf://datasets/)?(?P<repo>[\w.-]+/[\w.-]+)")


class AssetProvider:
    """Hands assets to environments; an :class:`env_assets.AssetSource`.

    A name is looked for in this order: in ``places``; as a folder in ``root``; and as what it says, a folder,
    a Parquet file or a repository of the Hub (``USER/NAME``). The names ``"mnist3d"``, ``"starstruck"`` and
    ``"wrench"`` are only ever looked for in the first two.

    Parameters
    ----------
    root : path
        Folder of data set folders.
    places : mapping of str to path, optional
        Folder, file or repository of the Hub that a name stands for, such as ``{"mnist3d": "digits"}``. Names
        are those of the toolkit, ``"abc"``, ``"minecraft"``, and those of :data:`realtouch.SHORT_NAMES`.
    revision : str, optional
        Branch, tag or commit of the repositories of the Hub. Each is looked up on first use and stays at the
        commit that it named then, in copies of the provider in other processes too.
    cache_meshes : int
        How many records are kept with the meshes that they have built; the least recently used leave first.
        Whoever asks for a kept one gets the same ``mesh``: copy it before you move it.
    generate : bool
        Make digits, scenes and the wrench in ``root`` where they are missing, from the embedded sources.
    seed : int
        Seed of what is made.
    per_class : int, optional
        Make only so many of each class of a split, instead of the published numbers.
    workers : int
        Number of processes that make it.

    Notes
    -----
    Order and length of a data set do not change for as long as the provider lives and no process rewrites its
    folder. A provider may be shared between threads, be pickled, and be used after a fork.

    Raises
    ------
    InputError
        A number that cannot be used, or a name in ``places`` that no environment asks for.

    Examples
    --------
    >>> provider = AssetProvider("assets", generate=True, per_class=10)  # doctest: +SKIP
    >>> digit = provider.meshes("mnist3d", "test")[0]  # doctest: +SKIP
    >>> provider.height_map(digit, pitch_m=0.0002).heights_m.shape  # doctest: +SKIP
    (310, 232)
    """

    def __init__(
        self,
        root: str | PathLike[str] = "tactile-assets",
        places: Mapping[str, str | PathLike[str]] | None = None,
        *,
        revision: str | None = None,
        cache_meshes: int = 64,
        generate: bool = False,
        seed: int = 0,
        per_class: int | None = None,
        workers: int = 1,
    ) -> None:
        self._maker = AssetMaker(expanded(fspath(root)).absolute(), seed, per_class, workers)
        self._places = _held_places(places or {})
        self._revision = revision
        self._commits: dict[str, str] = {}
        self._generate = generate
        require_integer("cache_meshes", cache_meshes, 0)
        self._memory = MemoryCache[Any, Any](cache_meshes)
        self._opened: dict[tuple[str, str, str], Any] = {}

    @property
    def root(self) -> Path:
        """Folder of data set folders."""
        return self._maker.root

    @overload
    def meshes(self, name: Literal["mnist3d"], split: str = "train") -> DigitMeshes: ...
    @overload
    def meshes(self, name: Literal["starstruck"], split: str = "train") -> SceneMeshes: ...
    @overload
    def meshes(self, name: Literal["wrench"], split: str = "train") -> WrenchMeshes: ...
    @overload
    def meshes(self, name: str | PathLike[str], split: str = "train") -> MeshSet: ...
    def meshes(self, name: str | PathLike[str], split: str = "train") -> MeshSet:
        """Return the meshes of a split, as a lazy sequence of records.

        Parameters
        ----------
        name : str or path
            ``"mnist3d"``, ``"starstruck"``, ``"wrench"``, or any data set of meshes.
        split : str
            Split of it.

        Returns
        -------
        mnist3d.MeshDataset, starstruck_gen.SceneMeshDataset, WrenchDataset or SolidDataset
            By what the data set holds.

        Raises
        ------
        InputError
            No such data set or split, or one of another kind than its name says.
        IntegrityError
            It is damaged or unfinished.
        HubError
            The repository cannot be reached or does not exist.
        """
        name = fspath(name)
        opened = self._opened.get(("meshes", name, split))
        if opened is None:
            opened = open_meshes(self._shards(name, split), name, self._memory)
            require_kind(opened, name)
            # The first to have opened it gives it to all: records are shared between threads.
            opened = self._opened.setdefault(("meshes", name, split), opened)
        found: MeshSet = opened
        return found

    def touches(
        self, name: str | PathLike[str], split: str = "train"
    ) -> TouchSeqDataset | TouchSingleDataset:
        """Return the rounds of real touches of a split, as a lazy sequence of records.

        Parameters
        ----------
        name : str
            A short name of :data:`realtouch.SHORT_NAMES` such as ``"real-single"``, or any data set of
            touches.
        split : str
            Split of it.

        Raises
        ------
        InputError, IntegrityError, HubError
            As :meth:`meshes`.
        """
        from realtouch.opening import load
        from tactile_toolkit.catalog.kinds import place_of

        name = fspath(name)
        opened = self._opened.get(("touches", name, split))
        if opened is None:
            place = place_of(self._place(name))
            # By commit and not by branch: rounds stay as they were when a user pushes meanwhile.
            opened = load(place, split, revision=self._commit_of(place))
            opened = self._opened.setdefault(("touches", name, split), opened)
        found: TouchSeqDataset | TouchSingleDataset = opened
        return found

    def volumes_m3(self, name: str, split: str = "train") -> NDArray[np.float64]:
        """Return the volume of each mesh of a split, in the order of :meth:`meshes`; makes no record.

        Returns
        -------
        ndarray of float64, shape (n,)
            Cubic metres. Data sets that store no volumes have them computed once.

        Raises
        ------
        InputError, IntegrityError, HubError
            As :meth:`meshes`.
        """
        view = MeshView(self.meshes(name, split), ())
        kept: MeshView = self._opened.setdefault(("measured", name, split), view)
        return kept.volumes_m3

    def height_map(self, record: Any, pitch_m: float = 0.0002) -> HeightMap:
        """Return the top surface of a mesh as a grid.

        Parameters
        ----------
        record : record, Mesh or trimesh.Trimesh
            In metres.
        pitch_m : float
            Side of a pixel, metres.

        Raises
        ------
        InputError
            No mesh, or a pitch that is not positive or makes the grid too large.
        """
        return top_surface(record, pitch_m)

    def bounds(self, record: Any) -> NDArray[np.float64]:
        """Return lowest and highest corner of a mesh, shape (2, 3), metres, in its own frame.

        Raises
        ------
        InputError
            No mesh.
        """
        return mesh_bounds_m(as_mesh(record).vertices_m, "the mesh")

    def placements(self, record: Any) -> tuple[Placement, ...]:
        """Return what stands where in a Starstruck scene, stars first; metres and radians, cell frame.

        Raises
        ------
        InputError
            The record is not a scene, or its data set does not store what stands where.
        """
        require_scene(record)
        found: tuple[Placement, ...] = record.placements
        return found

    def __getstate__(self) -> dict[str, Any]:
        """Leave open data sets behind; commits of the Hub go along."""
        return {**self.__dict__, "_opened": {}}

    def __repr__(self) -> str:
        return f"AssetProvider({str(self.root)!r})"

    def _place(self, name: str) -> str:
        """Return folder, file or repository that a name stands for."""
        if name in self._places:
            return self._places[name]
        # The toolkit's own names stand for the root even before anything is there: so it is made there, and a
        # folder of that name where the user happens to be is not taken for it.
        inside = self.root / name
        return str(inside) if name in KINDS or (is_there(inside) and inside.is_dir()) else name

    def _commit_of(self, place: str) -> str | None:
        """Return the commit of a repository, looked up on first use and kept; None for a folder or a file."""
        repo_id = repository_id(place)
        if repo_id is None:
            return None
        commit = self._commits.get(repo_id)
        if commit is None:
            from tactile_toolkit.hub.repository import HubRepository

            # The first answer stays, whichever thread it came from.
            commit = self._commits.setdefault(repo_id, HubRepository(repo_id, self._revision).snapshot.commit)
        return commit

    def _shards(self, name: str, split: str) -> tuple[Shard, ...]:
        place = self._place(name)
        made_here = name in KINDS and name not in self._places
        try:
            return find_shards(place, split, revision=self._commit_of(place))
        except (
            InputError,
            IntegrityError,
        ) as error:  # the latter of killed runs too, which continue
            if not made_here:
                raise
            if isinstance(error, InputError):
                self._maker.require_split(name, split)
            if not self._generate:
                raise self._named(error, name, split) from error
        with self._maker.lock(name):
            try:
                # Another process may have made it while this one waited.
                return find_shards(place, split)
            except (InputError, IntegrityError):
                self._maker.make(name, split)
        return find_shards(place, split)

    def _named(self, error: InputError | IntegrityError, name: str, split: str) -> Exception:
        """Name the command that makes what is missing; damaged data keeps its own message."""
        if isinstance(error, IntegrityError):
            return error
        found = error.what if self._maker.place(name).is_dir() else "it is not there"
        message = (
            f"no split {split!r} of {name!r} in {str(self.root)!r}: {found}; next: "
            f"{self._maker.next_step(name, split)}"
        )
        return InputError(message)


def _held_places(places: object) -> dict[str, str]:
    from realtouch.opening import SHORT_NAMES

    known = (*KINDS, *FOREIGN, *SHORT_NAMES)
    if not isinstance(places, Mapping):
        raise InputError(
            f"places of the AssetProvider are {places!r}; expected a mapping, such as {{'mnist3d': 'digits'}}"
        )
    for name in places:
        if name not in known:
            near = did_you_mean(str(name), known)
            raise InputError(
                f"places of the AssetProvider has {name!r}; expected names of {', '.join(known)}, each with "
                f"its folder{near}",
                next="data sets of other names are opened as `meshes(FOLDER)`",
            )
    return {name: _absolute(fspath(place)) for name, place in places.items()}


def _absolute(place: str) -> str:
    """Return a local place in full, so that it follows the current folder as little as the root does."""
    try:
        local = expanded(place)
        return str(local.absolute()) if local.exists() else place
    except (InputError, OSError, ValueError):  # too long a name, an unknown user's home, a null byte
        return place


def repository_id(place: str) -> str | None:
    """Return the repository (``USER/NAME``) that a place names; None for what is, or can only be, a path."""
    if place.startswith((".", "/", "~")) or is_there(Path(place)):
        return None
    match = _REPOSITORY.fullmatch(place)
    return None if match is None else match["repo"]
