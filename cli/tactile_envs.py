"""``tactile-envs``: environments, episodes of policies in them, and reports of policies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields
from functools import partial
from pathlib import Path
from typing import Any

import typer

from cli import application, options, output, runs
from tactile_toolkit import store
from tactile_toolkit.checked_fields import choice, integer, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import lazy
from tactile_toolkit.wording import with_count

# Imported when they are called: the package registers the environments, and imports numpy.
_environment_ids = lazy("tactile_envs:ids")
_episode_generator = lazy("tactile_envs.episodes.recording:EpisodeGenerator.of")
_episode_spec = lazy("tactile_envs.episodes.playing:EpisodeSpec")
_replay = lazy("tactile_envs.episodes.recording:replay")
_evaluate = lazy("tactile_envs.episodes.evaluation:evaluate")
_read_report = lazy("tactile_envs.episodes.evaluation:Report.read")
_compare = lazy("tactile_envs.episodes.evaluation:compare")
_draw_curves = lazy("tactile_envs.episodes.evaluation:draw_curves")

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


_ENV_ID = options.argument("ID", "Id of an environment (`tactile-envs list`), or module:namespace/Name-v0.")
_POLICY = text(
    "random",
    metavar="NAME",
    read=str,
    complete=("random", "constant", "oracle", "rule"),
    help="random, constant, oracle (knows the answer), rule (follows objects), or your own module:attribute.",
)
_ASSETS = text(
    metavar="DIR",
    read=str,
    help="Objects: a folder of data sets, a data set, or mesh files; made by default.",
)


@application.command(app)
def record(
    *,
    env_id: str = _ENV_ID,
    policy: str = _POLICY,
    episodes: int = integer(100, 1, help="Number of episodes."),
    num_envs: int = integer(64, 1, help="Environments side by side; random numbers depend on it."),
    seed: int = integer(0, help="Random seed."),
    image_format: str = choice("jpeg", ("jpeg", "png"), help="Format of the images."),
    assets: str | None = _ASSETS,
    out: str = options.out_folder("episodes"),
    generate_options: options.GenerateOptions,
    sink: output.Sink,
) -> None:
    """Record episodes of a policy as a data set of touches, with actions, predictions and rewards.

    Example: tactile-envs record TactileMNIST-Depth-test-v0 --episodes 200 --out episodes
    """
    spec = _episode_spec(env_id, episodes, num_envs, seed, assets=assets)
    generator = _episode_generator(spec, policy, image_format)
    runs.generate_set(sink, "playing episodes", generator, out, None, generate_options)


@application.command(app)
def replay(
    *,
    name: str = options.NAME,
    source_options: options.SourceOptions,
    limit: int | None = integer(None, 1, optional=True, help="Replay the first episodes only."),
    assets: str | None = _ASSETS,
    sink: output.Sink,
) -> None:
    """Play recorded actions again, and compare all images and rewards bit for bit.

    Example: tactile-envs replay episodes

    Exit code 1 if one differs.
    """
    with sink.progress("replaying", "episodes") as update:
        place = source_options.open_source(sink, name)
        result = _replay(place, assets=assets, limit=limit, on_progress=update)
    sink.document(asdict(result))
    counts = f"{with_count(result.episodes, 'episodes')}, {with_count(result.touches, 'touches')}"
    if result.difference is not None:
        sink.line(f"{name}: {counts}; {result.difference}")
        raise typer.Exit(application.EXIT_FAILED)
    sink.line(f"{name}: {counts}: all images and rewards are equal")


@application.command(app)
def evaluate(
    *,
    env_id: str = _ENV_ID,
    policy: str = _POLICY,
    episodes: int = integer(500, 1, help="Number of episodes of each seed."),
    seeds: int = integer(5, 1, 1000, help="Number of seeds: 0, 1, ..."),
    num_envs: int = integer(64, 1, help="Environments side by side; random numbers depend on it."),
    assets: str | None = _ASSETS,
    out: Path = options.local_out_folder("report"),
    workers: int = options.WORKERS,
    overwrite: bool = options.OVERWRITE,
    sink: output.Sink,
) -> None:
    """Report every metric of a policy, with 95 % intervals over objects: report.json, report.md, report.png.

    Example: tactile-envs evaluate TactileMNIST-Depth-test-v0 --policy constant --out constant
    """
    from tactile_envs.episodes.evaluation import REPORT_FILES, figure_class  # numpy

    figure_class()  # an evaluation takes minutes
    written = store.open_output(out, REPORT_FILES, overwrite=overwrite)
    with sink.progress("playing episodes", "groups") as update:
        spec = _episode_spec(env_id, episodes, num_envs, assets=assets)
        count = options.process_count(workers)
        report = _evaluate(spec, policy, seeds=seeds, workers=count, on_progress=update)
    written.write(report.contents())
    _print_reports(sink, {str(report.policy["name"]): report})
    sink.line(f"written to {out}; next: tactile-envs compare {out} OTHER")


@application.command(app)
def compare(
    *,
    reports: list[Path] = options.argument(
        "REPORT...",
        "Folders that `tactile-envs evaluate` wrote.",
        several=True,
        read=options.parse_local_path,
    ),
    out: Path | None = text(
        name="--out -o", metavar="PNG", read=options.parse_local_path, help="Picture of the curves."
    ),
    overwrite: bool = options.OVERWRITE,
    sink: output.Sink,
) -> None:
    """Compare reports of one protocol in a table, and draw their curves.

    Example: tactile-envs compare random constant --out curves.png
    """
    named = {str(path): path for path in reports}
    if len(named) < len(reports):
        raise InputError("names a report twice", next="name each folder once", field="reports")
    if out is None:
        _print_reports(sink, {name: _read_report(path) for name, path in named.items()})
        return
    if out.suffix.lower() != ".png":
        raise InputError(f"is {out.name!r}; expected a name that ends with .png", field="out")
    written = store.open_output(out, overwrite=overwrite)
    held = {name: _read_report(path) for name, path in named.items()}
    _print_reports(sink, held)
    written.write({out.name: _draw_curves(held)})
    sink.line(f"the curves are in {out}")


def _print_reports(sink: output.Sink, reports: Mapping[str, Any]) -> None:
    table = _compare(reports)
    sink.document({name: asdict(report) for name, report in reports.items()})
    sink.table(("metric", "", *(f"{name}: mean (95 % interval)" for name in reports)), table)


def _shown(value: object) -> object:
    """Return parts of an observation or an action with their shapes as text, other values as they are."""
    if not isinstance(value, Mapping):
        return value
    return " ".join(f"{name}{list(shape)}" for name, shape in value.items())


main = partial(application.run, app)
