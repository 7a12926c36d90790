"""The kind of synthetic touches, which are read as all touches are."""

from __future__ import annotations

from tactile_toolkit.kind import DatasetKind, lazy

KIND = DatasetKind(
    name="tactile_sim",
    package="realtouch",  # opens every data set in the schema of touches
    noun="round",
    nouns="rounds",
    content="synthetic touches",
    made_by="tactile-sim generate",
    card_template="tactile_sim.md",
    write_card=lazy("tactile_sim.sets.data_cards:write_card"),
    needs=("sensor_image", "sensor_video"),
    plan_previews=lazy("realtouch.touch_previews:plan_previews"),
    preview_spec="realtouch.touch_options:TouchPreviewSpec",
    plan_gallery=lazy("realtouch.touch_gallery:plan_gallery"),
    facts=lazy("tactile_sim.sets.data_cards:facts"),
)
