"""The kind of synthetic touches, which are read as all touches are."""

from __future__ import annotations

from tactile_toolkit.kind import DatasetKind, Specified, lazy


def _loader(manifest: Specified | None) -> str:
    # A training set has one picture a row, which `datasets` opens.
    is_pairs = manifest is not None and manifest.spec.get("operation") == "pairs"
    return "datasets.load_dataset" if is_pairs else "realtouch.load"


KIND = DatasetKind(
    name="tactile_sim",
    command="tactile-sim",
    package="realtouch",  # opens every data set in the schema of touches
    noun="round",
    nouns="rounds",
    content="synthetic touches",
    made_by="tactile-sim generate",
    card_template="tactile_sim.md",
    write_card=lazy("tactile_sim.sets.data_cards:write_card"),
    needs=("sensor_image", "sensor_video"),
    missing_commands=("validate", "export"),
    loader=_loader,
)
