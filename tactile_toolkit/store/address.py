"""Where data is, as users write it: a local path, or an address such as ``s3://BUCKET/FOLDER``.

One reading for every option and function that takes either. What an address must not hold (keys, signatures)
is never repeated in a message.
"""

from __future__ import annotations

import re

from tactile_toolkit.errors import InputError

_SCHEME = re.compile(r"(?P<scheme>[A-Za-z][A-Za-z0-9+.-]*)://(?P<rest>.*)", re.DOTALL)
_FOLDED = re.compile(r"(?:s3a?|gs|gcs|hf|abfs|az):/(?!/)")
_LOCAL_SCHEMES = ("file", "local")
_WEB_SCHEMES = ("http", "https")
_OTHER_NAMES = {"s3a": "s3", "gcs": "gs"}
_USER = re.compile(r"://[^/\s'\"@]*@")
_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f]")
_SIGNED = re.compile(r"\?[^\s'\"]*")


def scheme_of(place: str) -> str:
    """Return the scheme of an address, such as ``s3``; empty for a local path, also in the form ``file://``."""
    match = _SCHEME.fullmatch(place)
    scheme = match["scheme"].lower() if match else ""
    return "" if scheme in _LOCAL_SCHEMES else _OTHER_NAMES.get(scheme, scheme)


def is_remote(place: str) -> bool:
    """Return whether a place is not on a local file system."""
    return bool(scheme_of(place))


def shown(place: str) -> str:
    """Return a place for a message: without a user, a key or a signature, which may stand in it."""
    return _SIGNED.sub("?...", _USER.sub("://...@", place)) if is_remote(place) else place


def place_of_data(place: str) -> str:
    """Return a local path without ``file://``, or an address in its one form, without a slash at its end.

    Raises InputError for an address that names no bucket, is of the web, or holds a key or a signature.
    """
    match, scheme = _SCHEME.fullmatch(place), scheme_of(place)
    rest = match["rest"].rstrip("/") if match else ""
    bucket, *parts = rest.split("/")
    problem = ""
    if match is None:
        if _FOLDED.match(place):
            problem = (
                "is an address of which a slash was lost, as pathlib.Path does it; next: give it as text, or "
                "write ./ before it where a local folder is meant"
            )
    elif not scheme:
        if not match["rest"].startswith("/"):
            expected = f"{match['scheme']}:///FOLDER"
            problem = f"is not the address of a file; expected {expected}; next: write it so, or as a path"
    elif scheme in _WEB_SCHEMES:
        problem = (
            "is an address of the web, where a data set can be neither listed nor written; next: give a "
            "folder, s3://BUCKET/FOLDER, gs://BUCKET/FOLDER or USER/NAME on the Hub"
        )
    elif not bucket:
        problem = f"names no bucket; next: write it as {scheme}://BUCKET/FOLDER"
    elif "@" in bucket or "?" in rest:
        problem = (
            f"holds a user, a key or a signature; next: write {scheme}://BUCKET/FOLDER alone, and give "
            "credentials as the store's own tools take them, such as AWS_PROFILE"
        )
    elif _CONTROL.search(rest):
        problem = "holds a line break or another control character; next: leave it out"
    elif {".", ".."} & {bucket, *parts}:
        problem = "has '.' or '..' in it, which lead nowhere in a store; next: write the folder in full"
    if problem:
        raise InputError(f"{shown(place)!r} {problem}")
    if match is None:
        return place
    return f"{scheme}://{rest}" if scheme else rest or "/"
