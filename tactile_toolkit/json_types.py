"""The types of JSON values, such as specifications, whose fields only their kind of data set knows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

JsonObject: TypeAlias = Mapping[str, Any]
"""A JSON object that nothing changes."""

JsonValue: TypeAlias = Any
"""A JSON value of a file, which may have any type."""

JsonDict: TypeAlias = dict[str, Any]
"""A JSON object that is being made, or changed."""
