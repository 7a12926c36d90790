"""Assets by name, from a folder, from the Hub, or made on first use."""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar, overload

import pyarrow as pa

import mnist3d
import realtouch
import starstruck_gen
from env_assets import mesh_view
from env_assets.wrench.dataset import WrenchDataset
from tactile_toolkit import checked_fields, errors, kind as kinds, mesh, read, run, store
from tactile_toolkit.places import open_place
from tactile_toolkit.wording import did_you_mean

if TYPE_CHECKING:
    import trimesh

    from tactile_toolkit.generation import DefaultSet


KINDS: dict[str, kinds.DatasetKind] = {
    kind.name: kind for kind in kinds.DatasetKind.installed() if kind.default_set is not None
}
"""Assets that the toolkit can make without any input, by name."""
_ABC = "TimSchneider42/tactile-mnist-abc-dataset-small"
THIRD_PARTY_ASSETS: dict[str, str] = {
    "abc": f"CAD models of the ABC data set; the published selection is {_ABC} on the Hub",
    "minecraft": "items that the package shapes from textures on Mojang's servers, which must not be "
    "redistributed",
}
"""Assets that this toolkit does not make, and where the published ones are from."""
MeshSet = mesh.SolidDataset[Any]
"""A data set of meshes of any kind."""

T = TypeVar("T")

# Shorter work shows no progress, seconds.
_QUIET_S = 2.0


def published_meshes(name: str) -> str | None:
    """Return the data set on the Hub that has the published meshes of a kind; None if there is none."""
    if name == "abc":
        return _ABC
    kind = KINDS.get(name)
    if kind is None or not kind.published:
        return None
    return kind.published[0].repo_id


def open_meshes(shards: tuple[read.Shard, ...], name: str, needed: str = "") -> MeshSet:
    """Open the shards of one split as a data set of their kind.

    Raises InputError if they hold no meshes, or meshes of another kind than ``name`` states, or ``needed``,
    the name of the assets of an environment. The published wrench has none of our columns, so meshes of an
    unknown kind are accepted for it, and for environments.
    """
    # Imported now: a process that is forked while another thread imports something waits forever for the lock
    # of that import. Arrow imports pandas, if it is there, when it first makes an array of numpy.
    for module in ("pyarrow.parquet", "pyarrow.compute", "trimesh"):
        import_module(module)
    pa.array([0]).to_numpy()
    table = read.ShardedTable(shards)
    stated = mesh.SolidDataset.classes_of(shards, name, KINDS["mnist3d"].made_by, None)
    kind = kinds.DatasetKind.of_columns(read.column_names(table.schema), lambda: stated or ())
    expected = KINDS.get(needed or name)
    names = getattr(kind, "class_names", ()) if stated is None else stated
    accepts_unknown = needed or expected is None or not expected.published
    if expected is not None and kind is not expected and (kind is not None or not accepts_unknown):
        step = f"give a data set of {expected.nouns}"
        if not needed:
            step = f"give this data set another name, or {step}"
        raise errors.InputError(
            f"{name!r} was expected to hold {expected.nouns}, found "
            f"{getattr(kind, 'nouns', 'other meshes')} (classes {', '.join(names) or 'without names'})",
            next=f"{step}, which `{expected.made_by}` makes",
        )
    dataset = mesh.SolidDataset if kind is None else kind.dataset
    opened: MeshSet = dataset(table, label_names=names)
    return opened


class AssetProvider:
    """Provides assets to environments.

    A name is looked up in ``sources``; then as a folder in ``root``; then as the path of a folder or Parquet
    file, or as a repository of the Hub (``USER/NAME``). The names ``"mnist3d"``, ``"starstruck"`` and
    ``"wrench"`` are looked up only in the first two.

    Parameters
    ----------
    root : path
        Folder of data set folders.
    sources : mapping of str to path, optional
        Folder, file or repository of the Hub of a name, such as ``{"mnist3d": "digits"}``. Names
        are those of the toolkit, ``"abc"``, ``"minecraft"``, and those of :data:`realtouch.SHORT_NAMES`.
    revision : str, optional
        Branch, tag or commit of the repositories of the Hub. Each is looked up on first use and stays at the
        commit that it named then, in copies of the provider in other processes too.
    generate : bool
        Make digits, scenes and the wrench in ``root`` where they are missing, from the embedded sources.
    seed : int
        Seed of generated assets.
    per_class : int, optional
        Make only this many of each class of a split, instead of the published numbers.
    workers : int
        Number of processes that make assets. Long work shows its progress on stderr.

    Notes
    -----
    Order and length of a data set do not change for as long as the provider lives and no process rewrites its
    folder. A provider may be shared between threads, be pickled, and be used after a fork.

    Raises
    ------
    InputError
        A number that cannot be used, or a name in ``sources`` that no environment asks for.
    """

    def __init__(
        self,
        root: str | os.PathLike[str] = "tactile-assets",
        sources: Mapping[str, str | os.PathLike[str]] | None = None,
        *,
        revision: str | None = None,
        generate: bool = False,
        seed: int = 0,
        per_class: int | None = None,
        workers: int = 1,
    ) -> None:
        for name, number, least in (("seed", seed, 0), ("workers", workers, 1), ("per_class", per_class, 1)):
            if number is not None:
                checked_fields.checked_integer(number, f"{name} of the AssetProvider", least)
        self._root = store.expanded(os.fspath(root)).absolute()
        self._sources = _checked_sources(sources or {})
        self._revision = revision
        self._commits: dict[str, str | None] = {}
        self._generate = generate
        self._seed = seed
        self._per_class = per_class
        self._workers = workers
        self._opened: dict[tuple[str, str, str], Any] = {}

    @property
    def root(self) -> Path:
        """Folder of data set folders."""
        return self._root

    @overload
    def meshes(self, name: Literal["mnist3d"], split: str = "train") -> mnist3d.DigitDataset: ...
    @overload
    def meshes(
        self, name: Literal["starstruck"], split: str = "train"
    ) -> starstruck_gen.SceneMeshDataset: ...
    @overload
    def meshes(self, name: Literal["wrench"], split: str = "train") -> WrenchDataset: ...
    @overload
    def meshes(self, name: str | os.PathLike[str], split: str = "train") -> MeshSet: ...
    def meshes(self, name: str | os.PathLike[str], split: str = "train") -> MeshSet:
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
            Depending on the content of the data set.

        Raises
        ------
        InputError
            No such data set or split, or one of another kind than its name says.
        IntegrityError
            It is damaged or unfinished.
        HubError
            The repository cannot be reached or does not exist.
        """
        name = os.fspath(name)
        return self._once(("meshes", name, split), lambda: open_meshes(self._shards(name, split), name))

    def finished(self, name: str, split: str = "train") -> MeshSet | None:
        """Return the meshes of a split, or None if they are missing or unfinished; does not make them."""
        source = self._source_of(name)
        try:
            shards = open_place(source, revision=self._commit_of(source)).shards(split)
        except (errors.InputError, errors.IntegrityError):
            return None
        return open_meshes(shards, name)

    def plan_meshes(self, name: str, split: str = "train") -> mesh_view.PlannedView | None:
        """Return the meshes that :meth:`meshes` would make, each of which is made on first use.

        None if meshes of this kind cannot be made one by one. InputError: the folder holds another data set.
        """
        default_set = self._default_set(name)
        if default_set.plan_meshes is None:
            return None
        plan = default_set.plan_meshes(split)
        left = default_set.rows_left(self._source_of(name), split)
        records = [
            mesh_view.LazyMesh(number, label, partial(_planned_mesh, plan.make, number))
            for number, label in zip(plan.ids.tolist(), plan.labels.tolist(), strict=True)
        ]
        finished = partial(self.finished, name, split)
        make_all = partial(self.meshes, name, split)
        return mesh_view.PlannedView(
            records, KINDS[name].class_names, False, finished, make_all, left, left * plan.row_s
        )

    def is_being_made(self, name: str) -> bool:
        """Return whether a process makes a split of ``KINDS`` at this moment."""
        if not store.path_exists(self._lock_of(name)):
            return False
        try:
            with store.locked(self._lock_of(name), patience_s=0.0):
                return False
        except errors.InputError:  # another process holds it
            return True

    def _default_set(self, name: str) -> DefaultSet:
        make = KINDS[name].default_set
        assert make is not None, "all KINDS have one"
        default_set: DefaultSet = make(self._seed, self._per_class)
        return default_set

    def _lock_of(self, name: str) -> Path:
        """Return the file that is locked while splits of a kind are made."""
        # The file is never removed: otherwise two processes could each lock a file of that name.
        return self.root / f".{name}.lock"

    def touches(
        self, name: str | os.PathLike[str], split: str = "train"
    ) -> realtouch.TouchSeqDataset | realtouch.TouchSingleDataset | realtouch.TouchMixedDataset:
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
        source = self._source_of(os.fspath(name))
        # By commit and not by branch, so that rounds stay the same if a user pushes meanwhile.
        return self._once(
            ("touches", source, split),
            lambda: realtouch.load(source, split, revision=self._commit_of(source)),
        )

    def _once(self, what: tuple[str, str, str], make: Callable[[], T]) -> T:
        """Return the stored value, or make it; if two threads make it at once, the first one wins."""
        if what not in self._opened:
            self._opened.setdefault(what, make())
        kept: T = self._opened[what]
        return kept

    def __getstate__(self) -> dict[str, object]:
        """Leave out open data sets, but keep the commits of the Hub."""
        return {**self.__dict__, "_opened": {}}

    def __repr__(self) -> str:
        return f"AssetProvider({str(self.root)!r})"

    def _source_of(self, name: str) -> str:
        """Return the folder, file or repository of a name."""
        if name in self._sources:
            return self._sources[name]
        # The toolkit's own names are inside the root even before anything is there, so that it is made there;
        # a folder of that name in the current folder is not used.
        inside = self.root / name
        if name in KINDS or (store.path_exists(inside) and inside.is_dir()):
            return str(inside)
        return name

    def _commit_of(self, source: str) -> str | None:
        """Return the commit of a repository, looked up on first use; None for a path or a stated revision."""
        is_path = source.startswith(("/", ".", "~")) or store.path_exists(Path(source))
        if is_path or "/" not in source or "@" in source:  # short names are those of one repository
            return None
        if source not in self._commits:
            # If two threads ask at once, the first answer wins.
            self._commits.setdefault(source, open_place(source, revision=self._revision).revision)
        return self._commits[source]

    def _shards(self, name: str, split: str) -> tuple[read.Shard, ...]:
        source = self._source_of(name)
        try:
            opened = open_place(source, revision=self._commit_of(source))
            return opened.require_meshes("AssetProvider.meshes").shards(split)
        # IntegrityError also means an interrupted run.
        except (errors.InputError, errors.IntegrityError) as error:
            if name not in KINDS or name in self._sources:
                raise
            default_set = self._default_set(name)
            if isinstance(error, errors.InputError):
                self._refuse_missing(error, name, split, default_set)
            elif not self._generate:
                raise
        store.open_folder(str(self.root)).require_folder()
        with store.locked(self._lock_of(name), is_patient=True):
            try:
                # Another process may have made it while this one waited.
                return open_place(source).shards(split)
            except (errors.InputError, errors.IntegrityError):
                pass
            self._make(name, split, default_set, source)
        return open_place(source).shards(split)

    def _make(self, name: str, split: str, default_set: DefaultSet, source: str) -> None:
        nouns = KINDS[name].nouns
        what = f"making {nouns} (split {split}) in {source}"
        with run.shown_progress(what, nouns, _QUIET_S) as update:
            try:
                default_set.make(
                    *(source, split),
                    workers=self._workers,
                    on_progress=lambda progress: update(progress.done, progress.total),
                )
            except KeyboardInterrupt:
                # Without the frames of workers and locks.
                kept = f"interrupted; what is finished stays in {source!r}, and the same call continues"
                raise KeyboardInterrupt(kept) from None

    def _refuse_missing(
        self, error: errors.InputError, name: str, split: str, default_set: DefaultSet
    ) -> None:
        """Refuse a split that a kind does not have, or that may not be made here."""
        if split not in default_set.splits:
            raise errors.InputError(
                f"unknown split {split!r} of {name}; expected one of {', '.join(default_set.splits)}"
            ) from error
        if self._generate:
            return
        folder = self.root / name
        problem = error.what
        if not folder.is_dir():
            problem = "it does not exist"
        step = "or make the AssetProvider with generate=True"
        try:
            default_set.rows_left(str(folder), split)
        except (
            errors.InputError,
            errors.IntegrityError,
        ):  # made otherwise, so that it takes no further split
            root = self.root.with_name(f"{self.root.name}-{split}")
            folder = root / name
            step = f"and give {str(root)!r}; or add the split as the others were made"
        command = (KINDS[name].made_by, default_set.arguments(split), f"--out {shlex.quote(str(folder))}")
        raise errors.InputError(
            f"no split {split!r} of {name!r} in {str(self.root)!r}: {problem}",
            next=f"run `{' '.join(filter(None, command))}`, {step}",
        ) from error


def _planned_mesh(make: Callable[[int], mesh.Mesh], number: int) -> trimesh.Trimesh:
    return make(number).to_trimesh()


def _checked_sources(by_name: object) -> dict[str, str]:
    known = (*KINDS, *THIRD_PARTY_ASSETS, *realtouch.SHORT_NAMES)
    if not isinstance(by_name, Mapping):
        raise errors.InputError(
            f"sources of the AssetProvider are {by_name!r}; expected a mapping, such as "
            "{'mnist3d': 'digits'}"
        )
    for name in by_name:
        if name not in known:
            near = did_you_mean(str(name), known)
            raise errors.InputError(
                f"sources of the AssetProvider has {name!r}; expected names of {', '.join(known)}, each with "
                f"its folder{near}",
                next="data sets of other names are opened as `meshes(FOLDER)`",
            )
    return {name: _absolute_path(os.fspath(source)) for name, source in by_name.items()}


def _absolute_path(source: str) -> str:
    """Return the absolute path of a local place; other places as they are."""
    try:
        local = store.expanded(source)
        if local.exists():
            return str(local.absolute())
    except (errors.InputError, OSError, ValueError):  # too long a name, an unknown user's home, a null byte
        pass
    return source


def meshes_at(
    source: str | os.PathLike[str], split: str, unit: str | None = None, needed: str = ""
) -> mesh_view.MeshView | MeshSet:
    """Open mesh files, or a data set by folder or name on the Hub; raises as :meth:`AssetProvider.meshes`.

    ``unit`` is that of mesh files; InputError if the source holds none. ``needed`` is the name of the assets
    that an environment needs, such as ``"starstruck"``: a folder of data sets stands for the one of this
    name, and a data set of another kind of the toolkit is refused.
    """
    # An existing path in full: a name would first be looked for among the assets of the toolkit.
    named = _absolute_path(os.fspath(source))
    folder = Path(named)
    has_sets = needed in KINDS and store.path_exists(folder / needed) and (folder / needed).is_dir()
    if not has_sets:
        files = mesh_view.mesh_files(named, split, unit)
        if files is not None:
            return files
        has_sets = needed in KINDS and any(
            store.path_exists(folder / name / store.MANIFEST_FILE) for name in KINDS
        )
    mesh.refuse_unit(unit, os.fspath(source))
    if has_sets:
        return AssetProvider(folder).meshes(needed, split)
    return open_meshes(AssetProvider()._shards(named, split), named, needed)
