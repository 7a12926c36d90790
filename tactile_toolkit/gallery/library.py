"""The foreign library of the page: three.js, taken out of the installed trimesh, with its licence.

trimesh carries three.js in the template of its own notebook viewer, joined with that viewer's controls. Only
the library itself is taken: one line of minified code below a comment that names its authors and licence.
"""

from __future__ import annotations

import re
import zipfile
from dataclasses import dataclass
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

from tactile_toolkit.errors import InputError

__all__ = ["ViewerLibrary", "viewer_library"]

_TEMPLATE = "resources/templates/viewer.zip"
_LIBRARY = re.compile(
    r"(?P<notice>/\*\*\n \* @license\n(?: \*[^\n]*\n)*? \*/)\n(?P<code>!function[^\n]*\.THREE=[^\n]*)\n"
)
_RELEASE = re.compile(r'const \w+="(\d{2,3})"')
_LICENSE_FILE = re.compile(r"(?:^|/)LICEN[CS]E[^/]*$", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class ViewerLibrary:
    """A JavaScript library and what must be said about it.

    Attributes
    ----------
    name : str
        Name and release.
    origin : str
        Package that it was taken from, with its version.
    code : str
        The library, with the notice of its authors in front.
    license_text : str
        Notice and terms.
    """

    name: str
    origin: str
    code: str
    license_text: str


def viewer_library() -> ViewerLibrary:
    """Take three.js out of the installed trimesh.

    Raises
    ------
    InputError
        The installed trimesh does not carry it as known releases do, or not under the MIT licence.
    """
    distribution = metadata.distribution("trimesh")
    origin = f"trimesh {distribution.version}"
    found = _LIBRARY.search(_template(origin))
    if found is None or "SPDX-License-Identifier: MIT" not in found["notice"]:
        raise _absent(origin)
    release = _RELEASE.search(found["code"])
    name = f"three.js r{release[1]}" if release else "three.js"
    terms = _terms(distribution, origin)
    text = (
        f"{name}, in assets/three.js, was taken out of the Python package {origin} when this page was\n"
        f"built. Its notice:\n\n{found['notice']}\n\n"
        f"The MIT licence, as the package {origin} states it:\n\n{terms}"
    )
    return ViewerLibrary(name, origin, f"{found['notice']}\n{found['code']}\n", text)


def _template(origin: str) -> str:
    # Found without importing trimesh, which takes two seconds and has no part in this.
    spec = find_spec("trimesh")
    if spec is None or spec.origin is None:
        raise _absent(origin)
    try:
        with zipfile.ZipFile(Path(spec.origin).parent / _TEMPLATE) as archive:
            return archive.read("viewer.html.template").decode()
    except (OSError, KeyError, zipfile.BadZipFile) as error:
        raise _absent(origin) from error


def _terms(distribution: metadata.Distribution, origin: str) -> str:
    for file in distribution.files or []:
        if _LICENSE_FILE.search(str(file)):
            text = str(file.read_text())
            if "Permission is hereby granted, free of charge" in text:
                return text.strip() + "\n"
    raise _absent(origin)


def _absent(origin: str) -> InputError:
    return InputError(
        f"the installed {origin} carries no three.js with its licence where releases 4.9 to 5.2 do "
        f"({_TEMPLATE}); next: pip install 'trimesh>=4.9,<=5.2.0'"
    )
