"""The provider: assets by name, from a folder, from the Hub, or made on first use."""

from __future__ import annotations

import logging
import shlex
from collections.abc import Mapping, Sequence
from importlib import import_module
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol, overload, runtime_checkable

import numpy as np

from env_assets.height_map import HeightMap, top_surface
from env_assets.meshes import MeshView, mesh_bounds_m, mesh_files
from env_assets.wrench.kind import KIND as WRENCH
from env_assets.wrenches import WrenchDataset
from mnist3d.digit_dataset import DigitDataset
from mnist3d.kind import KIND as DIGITS
from starstruck_gen.kind import KIND as SCENES
from starstruck_gen.scene_dataset import SceneMeshDataset
from tactile_toolkit import hub, mesh, read, store
from tactile_toolkit.array_types import Float64
from tactile_toolkit.checked_fields import checked_integer
from tactile_toolkit.errors import InputError, IntegrityError, ToolkitError
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.mesh import SolidDataset as SolidDataset
from tactile_toolkit.places import kind_of_rows, open_place
from tactile_toolkit.wording import did_you_mean

if TYPE_CHECKING:
    from realtouch.touch_dataset import TouchSeqDataset, TouchSingleDataset
    from starstruck_gen.placement import Placement
    from tactile_toolkit.generation import Recipe


KINDS: dict[str, DatasetKind] = {kind.name: kind for kind in (DIGITS, SCENES, WRENCH)}
"""Assets that the toolkit can make without any input, by name."""

FOREIGN: dict[str, str] = {
    "abc": "CAD models of the ABC data set; the published selection is "
    "TimSchneider42/tactile-mnist-abc-dataset-small on the Hub",
    "minecraft": "items that the package shapes from textures on Mojang's servers, not to be passed on",
}
"""Assets that this toolkit does not make, and where the published ones are from."""

MeshSet = DigitDataset | SceneMeshDataset | WrenchDataset | SolidDataset[Any]
_DATASETS: dict[str, Any] = {
    DIGITS.name: DigitDataset,
    SCENES.name: SceneMeshDataset,
    WRENCH.name: WrenchDataset,
}
_LOG = logging.getLogger(__name__)


@runtime_checkable
class AssetSource(Protocol):
    """Provides assets by name, as :class:`env_assets.AssetProvider` does; all that an environment needs.

    Data sets keep order and length for as long as the source lives. All methods may be called from several
    threads, and in processes that were forked or spawned after the source was made.
    """

    def meshes(self, name: str, split: str = "train") -> Sequence[Any]:
        """Return the meshes of a split: records with ``id``, ``label``, ``vertices_m``, ``faces``, ``mesh``.

        Vertices are (V, 3) float32 in metres, faces (F, 3) int32, counter-clockwise seen from outside,
        ``mesh`` is a ``trimesh.Trimesh``. A plain list of such records will do: their classes are then those
        of the name.
        """
        ...

    def touches(self, name: str, split: str = "train") -> TouchSeqDataset | TouchSingleDataset:
        """Return the rounds of real touches of a split, such as ``realtouch.load`` opens them."""
        ...


class AssetProvider:
    """Provides assets to environments; an :class:`env_assets.AssetSource`.

    A name is looked for in this order: in ``places``; as a folder in ``root``; as the path of a folder or
    Parquet file, or a repository of the Hub (``USER/NAME``). The names ``"mnist3d"``, ``"starstruck"`` and
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
    generate : bool
        Make digits, scenes and the wrench in ``root`` where they are missing, from the embedded sources.
    seed : int
        Seed of what is made.
    per_class : int, optional
        Make only this many of each class of a split, instead of the published numbers.
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
        generate: bool = False,
        seed: int = 0,
        per_class: int | None = None,
        workers: int = 1,
    ) -> None:
        for name, number, least in (("seed", seed, 0), ("workers", workers, 1), ("per_class", per_class, 1)):
            if number is not None:
                checked_integer(number, f"{name} of the AssetProvider", least)
        self._root = store.expanded(fspath(root)).absolute()
        self._places = _checked_places(places or {})
        self._revision = revision
        self._commits: dict[str, str] = {}
        self._generate, self._seed, self._per_class, self._workers = generate, seed, per_class, workers
        self._opened: dict[tuple[str, str, str], Any] = {}

    @property
    def root(self) -> Path:
        """Folder of data set folders."""
        return self._root

    @overload
    def meshes(self, name: Literal["mnist3d"], split: str = "train") -> DigitDataset: ...
    @overload
    def meshes(self, name: Literal["starstruck"], split: str = "train") -> SceneMeshDataset: ...
    @overload
    def meshes(self, name: Literal["wrench"], split: str = "train") -> WrenchDataset: ...
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
        mnist3d.DigitDataset, starstruck_gen.SceneMeshDataset, WrenchDataset or SolidDataset
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
            opened = _open_meshes(self._shards(name, split), name)
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

        name = fspath(name)
        opened = self._opened.get(("touches", name, split))
        if opened is None:
            place = self._place(name)
            # By commit and not by branch: rounds stay as they were when a user pushes meanwhile.
            opened = load(place, split, revision=self._commit_of(place))
            opened = self._opened.setdefault(("touches", name, split), opened)
        found: TouchSeqDataset | TouchSingleDataset = opened
        return found

    def volumes_m3(self, name: str, split: str = "train") -> Float64:
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

    def bounds(self, record: Any) -> Float64:
        """Return lowest and highest corner of a mesh, shape (2, 3), metres, in its own frame.

        Raises
        ------
        InputError
            No mesh.
        """
        return mesh_bounds_m(mesh.as_mesh(record).vertices_m, "the mesh")

    def placements(self, record: Any) -> tuple[Placement, ...]:
        """Return the objects of a Starstruck scene, stars first; metres and radians, cell frame.

        Raises
        ------
        InputError
            The record is not a scene, or its data set does not store what stands where.
        """
        if not hasattr(type(record), "placements"):
            raise InputError(
                f"only scenes have placements, found a {type(record).__name__}",
                next="give a record of `meshes('starstruck')`",
            )
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
        return str(inside) if name in KINDS or (store.path_exists(inside) and inside.is_dir()) else name

    def _commit_of(self, place: str) -> str | None:
        """Return the commit of a repository, looked up on first use and kept; None for a folder or a file."""
        if place.startswith("/") or store.path_exists(Path(place)):
            return None

        named = hub.hub_name(place)
        if named is None or named.revision is not None:
            return None
        commit = self._commits.get(named.repo_id)
        if commit is None:
            commit = hub.open_repository(named.repo_id, self._revision).commit
            # The first answer stays, whichever thread it came from.
            commit = self._commits.setdefault(named.repo_id, commit)
        return commit

    def _shards(self, name: str, split: str) -> tuple[read.Shard, ...]:
        place = self._place(name)
        try:
            return open_place(place, revision=self._commit_of(place)).shards(split)
        except (InputError, IntegrityError) as error:  # the latter of killed runs too, which continue
            if name not in KINDS or name in self._places:
                raise
            recipe: Recipe = KINDS[name].recipe(self._seed, self._per_class)
            if isinstance(error, InputError):
                self._refuse_missing(error, name, split, recipe)
            elif not self._generate:
                raise
        # The file stays for good: were it removed, two processes could each hold a file of that name.
        lock = self.root / f".{name}.lock"
        with store.named_failures(str(lock)):
            self.root.mkdir(parents=True, exist_ok=True)
            lock.touch()
        with store.locked(lock, is_patient=True):
            try:
                # Another process may have made it while this one waited.
                return open_place(place).shards(split)
            except (InputError, IntegrityError):
                _LOG.info("making split %r of %s in %s", split, name, place)
                recipe.make(place, split, self._workers)
        return open_place(place).shards(split)

    def _refuse_missing(self, error: InputError, name: str, split: str, recipe: Recipe) -> None:
        """Refuse a split that a kind does not have, or one that is not to be made here."""
        if split not in recipe.splits:
            raise InputError(
                f"unknown split {split!r} of {name}; expected one of {', '.join(recipe.splits)}"
            ) from error
        if not self._generate:
            place = self.root / name
            found = error.what if place.is_dir() else "it is not there"
            out = f"--out {shlex.quote(str(place))}"
            command = " ".join(filter(None, (KINDS[name].made_by, recipe.arguments(split), out)))
            raise InputError(
                f"no split {split!r} of {name!r} in {str(self.root)!r}: {found}",
                next=f"run `{command}`, or make the AssetProvider with generate=True",
            ) from error


def _checked_places(places: object) -> dict[str, str]:
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
    return {name: absolute_path(fspath(place)) for name, place in places.items()}


def absolute_path(place: str) -> str:
    """Return a local place in full, so that it follows the current folder as little as the root does."""
    try:
        local = store.expanded(place)
        return str(local.absolute()) if local.exists() else place
    except (InputError, OSError, ValueError):  # too long a name, an unknown user's home, a null byte
        return place


def _open_meshes(shards: tuple[read.Shard, ...], name: str) -> MeshSet:
    """Open the shards of one split as the data set that they are.

    InputError where these are not meshes, or of another kind than their name promises. The published wrench
    has none of our columns: what is not known to be of another kind will do for one.
    """
    # Imported now: a process that is forked while another thread imports something waits for ever for that
    # import's lock. The first time that Arrow makes an array of numpy, it looks for pandas.
    for module in ("pyarrow.parquet", "pyarrow.compute", "trimesh"):
        import_module(module)
    import_module("pyarrow").array([0]).to_numpy()
    table = read.ShardedTable(shards)
    mesh.require_mesh_columns(table.schema, name, DIGITS.made_by)
    kind, expected = kind_of_rows(table.schema), KINDS.get(name)
    names = read.class_names(table.schema, () if kind is None else kind.class_names)
    if expected is not None and kind is not expected and (kind is not None or expected.published):
        raise InputError(
            f"{name!r} was expected to hold {expected.nouns}, found "
            f"{kind.nouns if kind else 'other meshes'} (classes {', '.join(names) or 'without names'})",
            next=f"give the data set by another name, or put {expected.nouns} in its place",
        )
    dataset: Any = SolidDataset if kind is None else _DATASETS.get(kind.name, SolidDataset)
    opened: MeshSet = dataset(table, label_names=names)
    return opened


def meshes_at(place: str | PathLike[str], split: str, unit: str | None = None) -> MeshView | MeshSet:
    """Open what a user names: mesh files, or a data set by folder or name on the Hub; raises as `meshes`.

    ``unit`` is that of mesh files; InputError where the place holds none.
    """
    # In full where it is there: a name would first be looked for among the assets of the toolkit.
    named = absolute_path(fspath(place))
    files = mesh_files(named, split, unit)
    if files is not None:
        return files
    mesh.refuse_unit(unit, fspath(place))
    return AssetProvider().meshes(named, split)


_UNKNOWN = {"kind": "", "rows": 0, "classes": (), "largest_mm": None, "volume_mm3": None, "problem": None}


def inventory(root: Path) -> list[dict[str, Any]]:
    """Look into every data set folder of a provider's folder, reading the vertices of all meshes.

    By name, splits in the order of the data set; one that cannot be used is named with the reason. InputError
    when the folder does not exist.
    """
    if not root.is_dir():
        raise InputError(
            f"{store.open_folder(str(root)).missing_message('data sets')}",
            next="give the folder of an AssetProvider",
        )
    found = []
    for place in sorted(each for each in root.iterdir() if each.is_dir() and not store.is_hidden(each.name)):
        try:
            splits = open_place(place).splits
        except InputError:  # some other folder: there are no Parquet files in it
            continue
        except ToolkitError as error:
            found.append({"name": place.name, "split": "", **_UNKNOWN, "problem": str(error)})
            continue
        for split in splits:
            summary = {"name": place.name, "split": split, **_UNKNOWN}
            try:
                summary |= _measured(place, split)
            except ToolkitError as error:
                summary["problem"] = str(error)
            found.append(summary)
    return found


def _measured(place: Path, split: str) -> dict[str, Any]:
    shards = open_place(place).shards(split)
    schema = read.ShardedTable(shards).schema
    # Only touches have the column; they are not opened, as no mesh is to be measured.
    if "pos_in_cell" in schema.names:
        return {"kind": "touches", "rows": sum(map(len, shards))}
    kind, view = kind_of_rows(schema), MeshView.of(_open_meshes(shards, str(place)))
    found = {"kind": kind.name if kind else "meshes", "rows": len(view), "classes": view.label_names}
    if not len(view):
        return found
    largest_mm = np.max(view.bounds_m[:, 1] - view.bounds_m[:, 0], axis=0) * mesh.MM_PER_M
    volumes_mm3 = view.volumes_m3 * mesh.MM_PER_M**3
    volume_mm3 = (round(float(volumes_mm3.min()), 3), round(float(volumes_mm3.max()), 3))
    return {**found, "largest_mm": tuple(largest_mm.round(3).tolist()), "volume_mm3": volume_mm3}
