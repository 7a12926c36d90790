"""``tactile-envs``: the list of environments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields
from functools import partial

from cli import application, options, output
from tactile_toolkit.kind import lazy
from tactile_toolkit.wording import with_count

# Imported when it is called: it registers the environments, and imports numpy.
_environment_ids = lazy("tactile_envs:ids")

app = application.new_app("tactile-envs", "Environments of active tactile perception.")


@application.command(app, "list")
def list_environments(
    *,
    words: list[str] | None = options.argument(
        "WORD", "Only ids with all of these words, such as ABCVolume DR.", several=True, default=None
    ),
    sink: output.Sink,
) -> None:
    """List the ids of environments, with a description of each.

    Example: tactile-envs list Minecraft
    """
    listed = _environment_ids(*words or ())
    sink.document(list(map(asdict, listed)))
    names = [field.name for field in fields(listed[0])]
    sink.table(names, [[_shown(getattr(row, name)) for name in names] for row in listed])
    sink.line(f"{with_count(len(listed), 'environments')}; the name for gymnasium.make is `tactile_envs/ID`")
    from env_assets import provider  # pyarrow

    for assets in dict.fromkeys(row.assets for row in listed):
        if assets in provider.THIRD_PARTY_ASSETS:
            sink.line(f"{assets}: give `assets`, a folder of meshes; {provider.THIRD_PARTY_ASSETS[assets]}")


def _shown(value: object) -> object:
    """Return parts of an observation or an action with their shapes as text, other values as they are."""
    if not isinstance(value, Mapping):
        return value
    return " ".join(f"{name}{list(shape)}" for name, shape in value.items())


main = partial(application.run, app)
