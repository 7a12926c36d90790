"""Tokens of the Hub: where one comes from, whose it is, and that none is ever shown."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable

__all__ = ["is_scrubbed", "scrub", "token_state", "whose_token"]

_TOKEN = re.compile(r"\b(?:hf|api_org)_[A-Za-z0-9]{6,}")
_HEADER = re.compile(r"(?i)\b(bearer|authorization:?)\s+(?!bearer)[^\s'\"]+")
# Addresses of stores carry what signs them behind the question mark.
_QUERY = re.compile(r"(https?://[^\s'\"<>?]+)\?[^\s'\"<>]+")
_HIDDEN = "hf_***"


def token_state() -> str:
    """Return where the token in use comes from (``"HF_TOKEN"`` or ``"stored login"``); empty without one."""
    from huggingface_hub import get_token

    if not get_token():
        return ""
    named = any(os.environ.get(name) for name in ("HF_TOKEN", "HUGGING_FACE_HUB_TOKEN"))
    return "HF_TOKEN" if named else "stored login"


def scrub(text: str) -> str:
    """Return a text without the token in use, without what looks like one, and without signatures."""
    from huggingface_hub import get_token

    token = get_token()
    if token:
        text = text.replace(token, _HIDDEN)
    return _HEADER.sub(rf"\1 {_HIDDEN}", _TOKEN.sub(_HIDDEN, _QUERY.sub(r"\1", text)))


def is_scrubbed(errors: Iterable[BaseException]) -> bool:
    """Tell whether errors can be shown as they are, without a token in any of them."""
    return all(scrub(str(error)) == str(error) for error in errors)


def whose_token() -> tuple[str, str, tuple[str, ...]]:
    """Ask the Hub for name, role and organisations of the token in use; empty when it does not say."""
    from huggingface_hub import HfApi

    try:
        person = HfApi().whoami()
        role = str(person.get("auth", {}).get("accessToken", {}).get("role", ""))
        return str(person["name"]), role, tuple(str(entry["name"]) for entry in person.get("orgs", ()))
    except Exception:
        # Only to word a refusal better: whatever goes wrong here must not hide that refusal.
        return "", "", ()
