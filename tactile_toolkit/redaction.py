"""Redaction of keys, tokens and passwords in all messages.

An address from a user is checked first: one that may hold a secret is refused, and not repeated. Messages,
which may quote clients and servers, are searched for anything that looks like a secret.
"""

from __future__ import annotations

import os
import re

# `pathlib` leaves one slash of an address. A single letter is a drive of Windows.
_ADDRESS = re.compile(
    r"(?:-[A-Za-z]|--[\w-]+=)?\s*(?P<scheme>[A-Za-z][A-Za-z0-9+.-]+)://?(?P<rest>.*)", re.DOTALL
)
# Everything else may be a user, a key, a password, a signature or a parameter.
_PLAIN = re.compile(r"[^/@?#;:%]*(?::[0-9]{1,5})?(?:/[^@?#;]*)?")
_PLAIN_ON_HUB = re.compile(rf"datasets/[^/@?#;:]+/[^?#;:]*|{_PLAIN.pattern}")
_PLAIN_LOCAL = re.compile(rf"/.*|{_PLAIN.pattern}", re.DOTALL)
_PLAIN_BY_SCHEME = {"hf": _PLAIN_ON_HUB, "file": _PLAIN_LOCAL, "local": _PLAIN_LOCAL}

_LOGIN = re.compile(r"(\w://)(?:[^/\s'\"<>@]*|[^/\s'\"<>@:]*:(?![0-9]+/)[^\s'\"<>]*)@")
_SIGNED = re.compile(r"(\w://[^\s'\"<>?#;]+)[?#;](?!\.\.\.)[^\s'\"<>]+?(?=;?(?:[\s'\"<>]|$))")
# Access keys of S3; tokens of users (hf_) and organisations (api_org_) of the Hub.
_TOKEN = re.compile(r"\b(?:(?:AKIA|ASIA)[A-Z0-9]{12,}|(?:hf|api_org)_[A-Za-z0-9]{10,})")
_HEADER = re.compile(
    r"(?i)\b(authorization['\"]?\s*[:=]\s*['\"]?(?:(?:basic|bearer|digest|token)\s+)?|bearer\s+)[^\s'\";,]+"
)
_SECRET_VARIABLES = ("AWS_SECRET_ACCESS_KEY", "AWS_SESSION_TOKEN", "AWS_ACCESS_KEY_ID", "HF_TOKEN")
_SHORTEST = 8  # shorter secrets are those of tests, such as the word `test`, which is also a split


def public_address(place: str) -> str:
    """Return an address that may be shown; of one that may hold a secret, only the scheme.

    An option in front of it stays, as in ``--out=s3://...``.
    """
    match = _ADDRESS.fullmatch(place)
    if match is None:
        return place
    plain = _PLAIN_BY_SCHEME.get(match["scheme"].lower(), _PLAIN)
    if plain.fullmatch(match["rest"]):
        return place
    return f"{place[: match.start('rest')]}..."


def redact(text: str, *secrets: str | None) -> str:
    """Return a text for a message, without keys, tokens, and users and signatures in addresses."""
    for secret in (*secrets, *map(os.environ.get, _SECRET_VARIABLES)):
        if secret and len(secret) >= _SHORTEST:
            text = text.replace(secret, "***")
    text = _HEADER.sub(r"\1***", _TOKEN.sub("***", text))
    return _SIGNED.sub(r"\1?...", _LOGIN.sub(r"\1...@", text))
