"""Places as users write them: local paths, and addresses of stores."""

from __future__ import annotations

import re

from tactile_toolkit.errors import InputError, require_public

_SCHEME = re.compile(r"(?P<scheme>[A-Za-z][A-Za-z0-9+.-]*)://(?P<rest>.*)", re.DOTALL)
_LOST_SLASH = re.compile(r"(?:s3a?|gs|gcs|hf|abfs|az):/(?!/)")
_LOCAL_SCHEMES = ("file", "local")
_WEB_SCHEMES = ("http", "https")
_OTHER_NAMES = {"s3a": "s3", "gcs": "gs"}


def scheme_of(place: str) -> str:
    """Return the scheme of an address, such as ``s3``; empty for a local path or a ``file://`` address."""
    match = _SCHEME.fullmatch(place)
    if match is None or match["scheme"].lower() in _LOCAL_SCHEMES:
        return ""
    scheme = match["scheme"].lower()
    return _OTHER_NAMES.get(scheme, scheme)


def is_remote(place: str) -> bool:
    """Return whether a place is not on a local file system."""
    return bool(scheme_of(place))


def normalize_uri(place: str) -> str:
    """Return a local path without ``file://``, or an address in canonical form, without a trailing slash.

    Raises InputError for an address that names no bucket, is of the web, or may hold a key or a signature.
    """
    require_public(place)
    match, scheme = _SCHEME.fullmatch(place), scheme_of(place)
    if match is None and not _LOST_SLASH.match(place):
        return place
    rest = ""
    if match:
        rest = match["rest"].rstrip("/")
    if match and not scheme and match["rest"].startswith("/"):
        return rest or "/"
    bucket, *parts = rest.split("/")
    is_plain = rest.isprintable() and not {".", ".."} & {bucket, *parts}
    if not scheme or not bucket or scheme in _WEB_SCHEMES or not is_plain:
        raise InputError(
            f"{place!r} is not the address of a data set; expected a folder, file:///FOLDER, "
            "s3://BUCKET/FOLDER or the like, of names without '.', '..' and control characters, "
            "and not of the web",
            next="write it so, as text (pathlib.Path drops a slash; a local folder of that name is ./NAME)",
        )
    return f"{scheme}://{rest}"
