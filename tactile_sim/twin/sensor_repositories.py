"""Calibrated sensors as folders and as repositories of the Hub: facts, card, upload and download."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tactile_sim.press.sensors import SENSORS, SensorModel
from tactile_sim.twin.twin_files import ARRAYS_FILE, SENSOR_FILE, open_sensor_output
from tactile_toolkit import __version__, cards, exchange, hub, kind, store
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.wording import markdown_text

_FILES = (ARRAYS_FILE, SENSOR_FILE)
_CARD_TEMPLATE = "sensor.md"


def is_sensor(name: str) -> bool:
    """Return whether a name is that of a local folder of a calibrated sensor, or else of a known one."""
    path = store.local_path(name)
    if path is not None and path.exists():
        return (path / SENSOR_FILE).is_file()
    return name in SENSORS


def sensor_facts(model: SensorModel) -> dict[str, str]:
    """Return the geometry of a sensor and the figures of its calibration as text."""
    facts = {
        "sensing area": f"{model.width_mm:.4g} x {model.height_mm:.4g} mm",
        "image": f"{model.width_px} x {model.height_px} pixels",
        "gel": f"{model.gel_mm:.4g} mm",
        "source": model.source,
    }
    for name, value in model.report.items():
        if isinstance(value, float):
            facts[name] = f"{value:.4g}"
        elif not isinstance(value, (list, dict)):
            facts[name] = str(value)
    return facts


def prepare_upload(
    folder: str,
    repository: str,
    options: exchange.UploadOptions,
    *,
    dry_run: bool = False,
    on_wait: Callable[[str], None] = lambda _: None,
) -> exchange.Upload:
    """Prepare the upload of the folder of a sensor, with a card from the results of its calibration.

    Raises as :meth:`tactile_toolkit.exchange.Upload.of_files`.
    """
    model = SensorModel.load(folder)
    root = store.open_folder(folder)
    files = {name: root.read_bytes(name) for name in _FILES}
    rows = "\n".join(f"| {name} | {markdown_text(value)} |" for name, value in sensor_facts(model).items())
    values = {"name": markdown_text(model.name), "version": __version__, "repository": repository}
    card = cards.Card.filled(_CARD_TEMPLATE, {**values, "rows": rows})
    what = f"twin of a sensor made by tactile-toolkit {__version__}"
    return exchange.Upload.of_files(
        files, card, repository, options, what=what, dry_run=dry_run, on_wait=on_wait
    )


@dataclass(frozen=True)
class SensorDownload:
    """Download of a sensor: its repository and the folder to write."""

    repository: hub.HubRepository
    out: str

    @classmethod
    def of(
        cls,
        name: str,
        out: str,
        *,
        revision: str | None = None,
        on_wait: Callable[[str], None] = lambda _: None,
    ) -> SensorDownload | None:
        """Plan the download of a repository; None if it holds no sensor.

        Raises InputError for other names, and HubError as the Hub answers.
        """
        if kind.DatasetKind.of_published(name) is not None:
            return None
        repository = hub.HubRepository.named(name, revision, on_wait)
        return cls(repository, out) if SENSOR_FILE in repository.remote else None

    @property
    def bytes(self) -> int:
        """Size of the files."""
        return sum(self.repository.file(path).size_bytes for path in _FILES)

    def run(self) -> SensorModel:
        """Write the folder and return the sensor.

        Raises InputError if the folder holds anything but the same files, and IntegrityError if the sensor
        is damaged; then nothing was written.
        """
        cached = self.repository.local_paths(_FILES)
        contents = {path: file.read_bytes() for path, file in zip(_FILES, cached, strict=True)}
        folder = store.open_folder(self.out)
        is_same = all(folder.exists(path) and folder.read_bytes(path) == contents[path] for path in _FILES)
        output = open_sensor_output(self.out, overwrite=is_same, next="choose another --out")
        output.write(contents, self._require_intact)
        return SensorModel.load(self.out)

    def _require_intact(self, folder: Path) -> None:
        try:
            SensorModel.load(folder)
        except InputError as error:
            raise IntegrityError(
                f"the sensor of {self.repository.repo_id!r} is damaged: {error.what}; nothing was written",
                next="ask its owner to upload it again",
            ) from error
