"""What a data set is, whatever is in it; a line imports only lines above it.

::

    errors wording versions     exception tree, numbers in words, versions of libraries
    arithmetic                  what every processor rounds alike
    kind                        all that the rest must know of a kind of data set, in one object
    run                         where tasks run
    store                       a data set folder: shards, manifest, build, resume, replace, verify
    cache                       files and objects that are kept to save time
    read                        Parquet -> Arrow -> numpy, record data sets, selection
    touch mesh hub              formats of touches and of solids; names, errors and repositories of the Hub
    catalog                     published sets and where they are
    pictures                    sheets, plots, renders
    gallery                     offline pages
    cards printing              data cards; plates and mesh files for printers
    exchange                    upload and download
"""

from __future__ import annotations

from typing import Any

__all__ = ["__version__"]

__version__: str


def __getattr__(name: str) -> Any:
    # On first use: looking it up takes longer than all that a help imports of the toolkit.
    if name == "__version__":
        from tactile_toolkit.versions import toolkit_version

        return toolkit_version()
    message = f"module 'tactile_toolkit' has no attribute {name!r}"
    raise AttributeError(message)
