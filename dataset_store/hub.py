"""Reading data sets from the Hugging Face Hub."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from dataset_store.errors import HubError

__all__ = ["HubRepository"]


@dataclass(frozen=True, slots=True)
class HubRepository:
    """A data set repository of the Hub.

    Parameters
    ----------
    repo_id : str
        ``USER/NAME``.
    revision : str or None
        Branch, tag or commit.

    Notes
    -----
    ``HF_HOME``, ``HF_ENDPOINT``, ``HF_HUB_OFFLINE`` and the stored token are honoured by huggingface_hub.
    """

    repo_id: str
    revision: str | None = None

    def files(self) -> list[str]:
        """List the paths of all files.

        Raises
        ------
        HubError
            The repository is unknown, private or gated, or the Hub cannot be reached and it is not cached.
        """
        from huggingface_hub import HfApi
        from huggingface_hub.constants import HF_HUB_OFFLINE

        with self._named_failures():
            if HF_HUB_OFFLINE:
                return self._cached_files()
            try:
                return list(
                    HfApi().list_repo_files(self.repo_id, revision=self.revision, repo_type="dataset")
                )
            except Exception as error:
                if not _is_connection_failure(error):
                    raise
                return self._cached_files()

    def _cached_files(self) -> list[str]:
        from huggingface_hub import snapshot_download

        root = Path(
            snapshot_download(
                self.repo_id, revision=self.revision, repo_type="dataset", local_files_only=True
            )
        )
        return sorted(str(file.relative_to(root)) for file in root.rglob("*") if file.is_file())

    def fetch(self, path: str) -> str:
        """Download one file into the Hub's cache (or find it there) and return its local path.

        Raises
        ------
        HubError
            As :meth:`files`.
        """
        from huggingface_hub import hf_hub_download

        with self._named_failures():
            return hf_hub_download(self.repo_id, path, repo_type="dataset", revision=self.revision)

    def address(self, path: str) -> str:
        """Return the fsspec address of a file, for reading it without downloading it whole."""
        revision = f"@{self.revision.replace('/', '%2F')}" if self.revision else ""
        return f"hf://datasets/{self.repo_id}{revision}/{path}"

    @contextlib.contextmanager
    def _named_failures(self) -> Iterator[None]:
        from huggingface_hub import errors

        try:
            yield
        except errors.GatedRepoError as error:
            hint = "is gated; next: accept its terms on its page and log in"
            raise self._failure(hint) from error
        except errors.RepositoryNotFoundError as error:
            hint = "was not found, or is private; next: check the name, or log in with `hf auth login`"
            raise self._failure(hint) from error
        except errors.RevisionNotFoundError as error:
            hint = f"has no revision {self.revision!r}"
            raise self._failure(hint) from error
        except errors.LocalEntryNotFoundError as error:
            hint = "cannot be fetched now (no network, or offline mode) and is not in the cache"
            raise self._failure(hint) from error
        except Exception as error:
            known = isinstance(error, (errors.HfHubHTTPError, OSError)) or _is_connection_failure(error)
            if not known:
                raise
            hint = f"could not be read: {type(error).__name__}: {error}; next: check the network, try again"
            raise self._failure(hint) from error

    def _failure(self, hint: str) -> HubError:
        return HubError(f"Hub data set {self.repo_id!r} {hint}")


def _is_connection_failure(error: Exception) -> bool:
    """Tell an error of the HTTP library, which is another one in each major release of huggingface_hub."""
    roots = {kind.__module__.partition(".")[0] for kind in type(error).__mro__}
    answered = getattr(error, "response", None) is not None
    return not answered and bool(roots & {"httpx", "httpx2", "httpcore", "requests", "urllib3"})
