"""Commands for calibrated sensors: facts, checks for changes, upload and download."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import typer

import tactile_sim
from cli import contents, hub as hub_commands
from cli.application import EXIT_FAILED
from cli.options import ANY_SET, CONFIG, FOLDER, REVISION, WORKERS, Opening, argument, local_place
from cli.output import Sink
from tactile_sim.press.sensors import SENSORS, SensorModel
from tactile_toolkit import __version__, cards, catalog, exchange, places, store
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.wording import markdown_text, with_count

SENSOR_FILE = "sensor.json"
_FILES = (SENSOR_FILE, "arrays.npz")
_CARD_TEMPLATE = "sensor.md"


def is_sensor(name: str) -> bool:
    """Return whether a name is that of a local folder of a calibrated sensor."""
    path = store.local_path(name)
    return path is not None and (path / SENSOR_FILE).is_file()


def show_sensor(
    *,
    name: str = ANY_SET,
    row: int = contents.ROW,
    split: str | None = catalog.SPLIT,
    opening: Opening,
    sink: Sink,
) -> None:
    """Show a row of a data set, or the facts of a sensor.

    Examples: show DIR --row 3 --split test;  show my-sensor;  show digit
    """
    if name not in SENSORS and not is_sensor(name):
        contents.show(name=name, row=row, split=split, opening=opening, sink=sink)
        return
    model = SensorModel.named(name)
    sink.document({"sensor": model.to_dict(), "report": dict(model.report)})
    print_sensor(sink, model)


def print_sensor(sink: Sink, model: SensorModel) -> None:
    """Print the facts of a sensor, and the touches that its calibration left out."""
    sink.table(("sensor", model.name), list(_facts(model).items()))
    touches = model.report.get("touches", [])
    if touches:
        used = sum(bool(each["used"]) for each in touches)
        sink.line(f"calibrated with {used} of {with_count(len(touches), 'touches')}")
    for each in touches:
        if not each["used"]:
            sink.line(f"  left out: {each['name']}: {each['reason']}")


def _facts(model: SensorModel) -> dict[str, str]:
    facts = {
        "sensing area": f"{model.width_mm:.4g} x {model.height_mm:.4g} mm",
        "image": f"{model.width_px} x {model.height_px} pixels",
        "gel": f"{model.gel_mm:.4g} mm",
        "source": model.source,
    }
    for name, found in model.report.items():
        if isinstance(found, float):
            facts[name] = f"{found:.4g}"
        elif not isinstance(found, (list, dict)):
            facts[name] = str(found)
    return facts


def check(
    *,
    sensor: Path = argument("MODEL", "Folder that `tactile-sim calibrate` wrote.", read=local_place),
    source: str = argument("SET", "Recent touches: a data set, or a folder of images."),
    sink: Sink,
) -> None:
    """Check whether a sensor has changed since it was calibrated.

    The touched objects do not matter; the places on the gel should differ. Exit code 1 if a figure is beyond
    its limit.

    Example: tactile-sim check my-sensor recordings-of-today
    """
    model = SensorModel.load(sensor)
    found = tactile_sim.check_sensor(model, tactile_sim.images_of(source))
    sink.document({"sensor": model.name, **found.to_dict()})
    rows = [
        (each.name, f"{each.value:.3g}", f"{each.limit:g}", "ok" if each.ok else "CHANGED", each.meaning)
        for each in found.figures
    ]
    sink.table(("figure", "found", "limit", "", "what it is"), rows)
    state = "the sensor is as it was calibrated"
    if not found.ok:
        state = "the sensor has changed: calibrate it again"
    sink.line(f"{with_count(found.images, 'images')} compared with {sensor}; {state}")
    if not found.ok:
        raise typer.Exit(EXIT_FAILED)


def upload_sensor(
    *,
    kind: DatasetKind,
    folder: str = FOLDER,
    repository: str = hub_commands.REPOSITORY,
    options: exchange.UploadOptions,
    dry_run: bool = hub_commands.SENDS_NOTHING,
    yes: bool = hub_commands.SENDS_UNASKED,
    workers: int = WORKERS,
    sink: Sink,
) -> None:
    """Verify a data set folder, or a sensor, and upload it to the Hugging Face Hub.

    Only missing files are sent. After an interruption, the same command continues; after success, it sends
    nothing. The card of a sensor is written from the results of its calibration.
    """
    if not is_sensor(folder):
        given: dict[str, Any] = {"kind": kind, "options": options, "workers": workers, "sink": sink}
        hub_commands.upload(folder=folder, repository=repository, dry_run=dry_run, yes=yes, **given)
        return
    hub_commands.quiet_client(is_all=sink.quiet or not sys.stderr.isatty())
    model, root = SensorModel.load(folder), store.open_folder(folder)
    files = {name: root.read_bytes(name) for name in _FILES}
    files[store.CARD_FILE] = _card(model, repository).encode()
    what = f"twin of a sensor made by tactile-toolkit {__version__}"
    prepared = exchange.Upload.of_files(
        files, repository, options, what=what, dry_run=dry_run, on_wait=sink.info
    )
    lines = [f"next: tactile-sim download {repository} --out my-sensor"]
    hub_commands.finish_upload(sink, prepared, lambda _revision: lines, dry_run=dry_run, yes=yes)


def _card(model: SensorModel, repository: str) -> str:
    rows = "\n".join(f"| {name} | {markdown_text(value)} |" for name, value in _facts(model).items())
    values = {"name": markdown_text(model.name), "version": __version__, "repository": repository}
    return cards.render_card(_CARD_TEMPLATE, {**values, "rows": rows})


def download_sensor(
    *,
    kind: DatasetKind,
    name: str = hub_commands.PUBLISHED,
    split: list[str] | None = hub_commands.SPLITS,
    revision: str | None = REVISION,
    config_name: str | None = CONFIG,
    out: str | None = hub_commands.FETCHED_TO,
    dry_run: bool = hub_commands.FETCHES_NOTHING,
    yes: bool = hub_commands.FETCHES_UNASKED,
    sink: Sink,
) -> None:
    """Download a data set from the Hub, or some of its splits, or a sensor, and check every file.

    After an interruption, the same command continues. `list` names the published data sets. A sensor needs
    --out.
    """
    repository = None
    if out is not None and not split and places.published_set(name) is None:
        hub_commands.quiet_client(is_all=True)
        repository = places.find_repository(name, revision, sink.info)
    if repository is None or out is None or SENSOR_FILE not in repository.remote:
        given: dict[str, Any] = {"kind": kind, "split": split, "out": out, "sink": sink}
        given |= {"revision": revision, "config_name": config_name}
        hub_commands.download(name=name, dry_run=dry_run, yes=yes, **given)
        return
    files = [repository.file(path) for path in _FILES]
    sizes = sum(file.size_bytes for file in files)
    folder = store.open_folder(out)
    document = {"repository": repository.repo_id, "commit": repository.commit, "bytes": sizes}
    sink.document({**document, "dry_run": dry_run, "folder": out})
    if dry_run:
        sink.line(f"would fetch {with_count(len(files), 'files')} of a sensor; nothing was fetched")
        return
    unknown = set(folder.names()) - {*_FILES}
    if unknown:
        raise InputError(
            f"{out!r} holds {sorted(unknown)[0]!r}, which is not of a sensor; nothing was fetched",
            next="choose another folder with --out",
        )
    folder.require_folder()
    for path, cached in zip(_FILES, repository.local_paths(_FILES), strict=True):
        folder.write_bytes(path, cached.read_bytes())
    model = SensorModel.load(out)
    sink.line(f"sensor {model.name!r} is in {out}; next: tactile-sim show {out}")
