"""Reading data sets from the Hugging Face Hub: every file is whole, or is not handed out."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from tactile_toolkit.errors import HubError, InputError, IntegrityError
from tactile_toolkit.hub.errors import named_failures, not_cached
from tactile_toolkit.hub.fetch import Transfer, fetch_whole, is_whole
from tactile_toolkit.hub.snapshot import HubSnapshot, RepositoryCache, look_at
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest
from tactile_toolkit.store.origin import Digest, HubFile

__all__ = ["HubRepository"]


@dataclass(frozen=True)
class HubRepository:
    """A data set repository of the Hub, at one commit.

    Parameters
    ----------
    repo_id : str
        ``USER/NAME``.
    revision : str or None
        Branch, tag or commit. What it names is looked up on first use and stays so for this object, so that
        all files are of one commit.
    insists : bool
        Wait for a Hub in trouble even where the cache could answer in its place.
    on_wait : callable
        Told, in a sentence, why there is a wait.

    Notes
    -----
    ``HF_HOME``, ``HF_ENDPOINT``, ``HF_HUB_OFFLINE`` and the stored token are honoured. Files lie in the Hub's
    own cache, so that other programs find them there.
    """

    repo_id: str
    revision: str | None = None
    insists: bool = False
    on_wait: Callable[[str], None] = field(default=lambda _: None, repr=False, compare=False)

    @cached_property
    def snapshot(self) -> HubSnapshot:
        """What the repository holds; from the cache when the Hub cannot be reached.

        Raises
        ------
        HubError
            The repository is unknown, private or gated, or the Hub cannot be reached and it is not cached.
        """
        return look_at(self.repo_id, self.revision, insists=self.insists, on_wait=self.on_wait)

    @cached_property
    def manifest(self) -> Manifest | None:
        """The manifest of a data set made by the toolkit; None of any other.

        Raises
        ------
        IntegrityError
            The manifest is damaged.
        HubError
            As :attr:`snapshot`.
        """
        if MANIFEST_FILE not in self.snapshot.files:
            return None
        text = Path(self._fetch(MANIFEST_FILE)).read_text(encoding="utf-8", errors="replace")
        return Manifest.from_json(text, f"{self.repo_id}/{MANIFEST_FILE}") if _is_ours(text) else None

    @property
    def has_answered(self) -> bool:
        """Whether the Hub itself has said what it holds; asks nobody."""
        seen: HubSnapshot | None = self.__dict__.get("snapshot")
        return seen is not None and not seen.is_cache

    @property
    def may_answer_later(self) -> bool:
        """Whether the cache answered for a Hub whose trouble may pass; asks nobody."""
        seen: HubSnapshot | None = self.__dict__.get("snapshot")
        return seen is not None and seen.may_pass

    def files(self) -> list[str]:
        """List the paths of all files.

        Returns
        -------
        list of str
            When the Hub cannot be asked, those in the cache and those that a cached manifest lists.

        Raises
        ------
        HubError
            As :attr:`snapshot`.
        """
        listed = set(self.snapshot.files)
        if self.snapshot.is_cache and self.manifest is not None:
            listed |= {record.shard.data_path for record in self.manifest.shards}
        return sorted(listed)

    @contextlib.contextmanager
    def told_apart(self, what: str) -> Iterator[None]:
        """Call missing what is only not cached by that name, when the Hub could not be asked."""
        try:
            yield
        except (InputError, IntegrityError) as error:
            if not self.snapshot.is_cache or self.manifest is not None:
                raise
            raise not_cached(self.repo_id, what) from error

    def fetch(
        self,
        path: str,
        on_bytes: Callable[[int], None] = lambda _: None,
        on_wait: Callable[[str], None] | None = None,
    ) -> str:
        """Bring one file into the Hub's cache, or find it there, and return its local path.

        Parameters
        ----------
        path : str
            Place of the file in the repository.
        on_bytes : callable
            Told the number of bytes each time some have arrived.
        on_wait : callable, optional
            Told, in a sentence, why there is a wait; that of the repository by default.

        Returns
        -------
        str
            The file has the checksum of the manifest, where there is one, and else that of the Hub. It is
            read for that once, and again only after it has changed.

        Raises
        ------
        IntegrityError
            It arrived damaged twice, or is not what the manifest says; nothing of it is kept.
        HubError
            It is not there, or cannot be fetched now.
        StorageError
            The cache cannot hold it.
        """
        self.expected(path)
        return self._fetch(path, on_bytes, on_wait)

    def expected(self, path: str) -> Digest | None:
        """Return what a file must be: what the manifest says, or else the Hub; None where neither is known.

        Raises
        ------
        IntegrityError
            The manifest and the Hub disagree: fetching it would not help.
        HubError
            There is no such file.
        """
        manifest = None if path == MANIFEST_FILE else self.manifest
        listed = _listed(manifest, path) if manifest is not None else None
        if listed is not None and path not in self.snapshot.files:
            return listed
        on_hub = self._entry(path).digest
        if listed is None or on_hub is None or on_hub.kind != listed.kind:
            return listed or on_hub
        if listed != on_hub:
            message = (
                f"{path!r} of Hub data set {self.repo_id!r} is not the file that its {MANIFEST_FILE} lists: "
                f"{on_hub}, expected {listed}; nothing was fetched; next: ask its owner to upload it again"
            )
            raise IntegrityError(message)
        return listed

    def size_bytes(self, path: str) -> int:
        """Return the size of a file as the Hub, or a cached manifest, tells it.

        Raises
        ------
        HubError
            There is no such file.
        """
        records = self.manifest.shards if self.manifest is not None else ()
        listed = {record.shard.data_path: record.bytes for record in records}
        return listed[path] if path in listed else self._entry(path).size_bytes

    def address(self, path: str) -> str:
        """Return the fsspec address of a file at the commit, for reading it without downloading it whole.

        Raises
        ------
        HubError
            As :attr:`snapshot`.
        """
        # The commit, not what it is called: a branch may move on while its files are read in turn.
        return f"hf://datasets/{self.repo_id}@{self.snapshot.commit}/{path}"

    def cached(self, path: str) -> Path | None:
        """Return a file that is in the Hub's cache, whole; None otherwise. Asks nobody, fetches nothing."""
        place = RepositoryCache(self.repo_id).file(self.snapshot.commit, path)
        if place is None:
            return None
        digest = self.expected(path)
        return place if digest is None or is_whole(place, digest) else None

    def transfer(
        self, path: str, on_bytes: Callable[[int], None], on_wait: Callable[[str], None]
    ) -> Transfer:
        """Return how to fetch one file.

        Raises
        ------
        HubError
            The Hub cannot be reached.
        """
        from huggingface_hub import hf_hub_url

        entry = self._entry(path)
        digest = self.expected(path)
        if self.snapshot.is_cache or digest is None:
            raise not_cached(self.repo_id, repr(path))
        url = hf_hub_url(self.repo_id, path, repo_type="dataset", revision=self.snapshot.commit)
        return Transfer(self.repo_id, path, url, entry.size_bytes, digest, on_bytes, on_wait)

    def _entry(self, path: str) -> HubFile:
        entry = self.snapshot.files.get(path)
        if entry is not None:
            return entry
        if self.snapshot.is_cache:
            raise not_cached(self.repo_id, repr(path))
        message = f"Hub data set {self.repo_id!r} has no file {path!r}; next: see what it has on its page"
        raise HubError(message)

    def _fetch(
        self,
        path: str,
        on_bytes: Callable[[int], None] = lambda _: None,
        on_wait: Callable[[str], None] | None = None,
    ) -> str:
        cache = RepositoryCache(self.repo_id)
        found = cache.file(self.snapshot.commit, path)
        if found is not None:
            whole = self.cached(path)
            if whole is not None:
                return str(whole)
            cache.remove(self.snapshot.commit, path)
        transfer = self.transfer(path, on_bytes, on_wait or self.on_wait)
        # The cache calls a content by what the Hub says of it, which a manifest may not know.
        name = self._entry(path).digest or transfer.digest
        blob = cache.blob(name)
        with named_failures(self.repo_id, self.revision, f"fetching {path!r} of"):
            if blob.exists() and not is_whole(blob, transfer.digest):
                blob.unlink()
            fetch_whole(transfer, blob, cache.stage(name))
            return str(cache.link(self.snapshot.commit, path, blob))


def _listed(manifest: Manifest, path: str) -> Digest | None:
    """Return what a manifest says of a file; None when it does not list it."""
    for record in manifest.shards:
        if record.shard.data_path == path:
            return Digest("sha256", record.sha256)
    checksum = (manifest.files or {}).get(path)
    return Digest("sha256", checksum) if checksum else None


def _is_ours(text: str) -> bool:
    """Tell a manifest of the toolkit from a file of the same name that other tools write."""
    try:
        values = json.loads(text)
    except ValueError:
        return False
    return isinstance(values, dict) and {"schema_version", "shards"} <= values.keys()
