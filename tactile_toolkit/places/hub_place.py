"""Places on the Hub: a repository, or a folder or file in it."""

from __future__ import annotations

from tactile_toolkit import hub, store
from tactile_toolkit.places.place import Place, shards_by_split
from tactile_toolkit.places.published import named_on_hub
from tactile_toolkit.places.split_files import (
    CARD_FILE,
    PARQUET,
    USUAL_SPLIT,
    parquet_paths,
    require_some,
    split_of_file,
    splits_by_card,
    splits_by_name,
    unknown_split,
)


def hub_place(name: str, revision: str | None, config: str | None) -> Place:
    """Resolve a name of the Hub, or the short name of a published set."""
    named = named_on_hub(name, revision)
    repository = hub.open_repository(named.repo_id, named.revision)
    if named.path.endswith(PARQUET):
        split = split_of_file(named.path.rpartition("/")[2]) or USUAL_SPLIT
        return Place(name, repository, {split: (named.path,)}, is_file=True)
    return repository_place(repository, name, named.path, config)


def repository_place(
    repository: hub.HubRepository, name: str, path: str = "", config: str | None = None
) -> Place:
    """Return the place of a repository of the Hub, or of a folder in it.

    Raises
    ------
    IntegrityError
        The name of a file leads out of a folder; nothing was fetched.
    """
    inside = ""
    if path:
        inside = f"{path}/"
    paths = parquet_paths(each for each in repository.files() if each.startswith(inside))
    store.names_inside(paths, f"Hub data set {repository.repo_id!r}")
    manifest = repository.manifest
    if manifest is not None:
        # Uploads keep other files: shards of an earlier data set may be next to these.
        listed = shards_by_split(manifest)
        files = {split: tuple(each for each in found if each in {*paths}) for split, found in listed.items()}
        return Place(name, repository, files, manifest)
    if paths and CARD_FILE in repository.remote and not path:
        card = repository.local_paths((CARD_FILE,))[0].read_bytes()
        named = splits_by_card(card, paths, config, name)
        if named is not None:
            if repository.is_cache and not any(named.values()):
                raise hub.not_cached(repository.repo_id, "it")
            return Place(name, repository, require_some(named, name), config=config)
    relative = splits_by_name((each.removeprefix(inside) for each in paths), name)
    found = {split: tuple(f"{inside}{each}" for each in held) for split, held in relative.items()}
    if not found:
        if repository.is_cache:
            raise hub.not_cached(repository.repo_id, "it")
        raise unknown_split("", (), name)
    return Place(name, repository, found)
