"""Keys, tokens and passwords are kept out of all messages.

An address from a user is judged before anything else is done with it: one that may hold more than a place is
refused, and not repeated. Messages, which may quote clients and servers, are searched for what looks secret.
"""

from __future__ import annotations

import os
import re

# With one slash: what `pathlib` makes of an address. A single letter is a drive of Windows.
_ADDRESS = re.compile(
    r"(?:-[A-Za-z]|--[\w-]+=)?\s*(?P<scheme>[A-Za-z][A-Za-z0-9+.-]+)://?(?P<rest>.*)", re.DOTALL
)
# Anything else may be a user, a key, a password, a signature or a parameter.
_PLAIN = re.compile(r"[^/@?#;:%]*(?::[0-9]{1,5})?(?:/[^@?#;]*)?")
_PLAIN_ON_HUB = re.compile(rf"datasets/[^/@?#;:]+/[^?#;:]*|{_PLAIN.pattern}")
_PLAIN_LOCAL = re.compile(rf"/.*|{_PLAIN.pattern}", re.DOTALL)
_PLAIN_BY_SCHEME = {"hf": _PLAIN_ON_HUB, "file": _PLAIN_LOCAL, "local": _PLAIN_LOCAL}

_LOGIN = re.compile(r"(\w://)(?:[^/\s'\"<>@]*|[^/\s'\"<>@:]*:(?![0-9]+/)[^\s'\"<>]*)@")
_SIGNED = re.compile(r"(\w://[^\s'\"<>?#;]+)[?#;](?!\.\.\.)[^\s'\"<>]+?(?=;?(?:[\s'\"<>]|$))")
# Access keys of S3; tokens of users of the Hub begin with hf_, those of organisations with api_org_.
_TOKEN = re.compile(r"\b(?:(?:AKIA|ASIA)[A-Z0-9]{12,}|(?:hf|api_org)_[A-Za-z0-9]{10,})")
_HEADER = re.compile(
    r"(?i)\b(authorization['\"]?\s*[:=]\s*['\"]?(?:(?:basic|bearer|digest|token)\s+)?|bearer\s+)[^\s'\";,]+"
)
_SECRET_VARIABLES = ("AWS_SECRET_ACCESS_KEY", "AWS_SESSION_TOKEN", "AWS_ACCESS_KEY_ID", "HF_TOKEN")
_SHORTEST = 8  # shorter ones are those of tests, such as the word `test`, which is a split, too


def public_address(place: str) -> str:
    """Return a place as it may be shown: only the scheme of an address that may hold more than a place.

    An option in front of it belongs to it, as in ``--out=s3://...``.
    """
    match = _ADDRESS.fullmatch(place)
    if match is None:
        return place
    plain = _PLAIN_BY_SCHEME.get(match["scheme"].lower(), _PLAIN)
    if plain.fullmatch(match["rest"]):
        return place
    return f"{place[: match.start('rest')]}..."


def redact(text: str, *secrets: str | None) -> str:
    """Return a text for a message: without keys and tokens, nor users and signatures of addresses."""
    for secret in (*secrets, *map(os.environ.get, _SECRET_VARIABLES)):
        if secret and len(secret) >= _SHORTEST:
            text = text.replace(secret, "***")
    text = _HEADER.sub(r"\1***", _TOKEN.sub("***", text))
    return _SIGNED.sub(r"\1?...", _LOGIN.sub(r"\1...@", text))
