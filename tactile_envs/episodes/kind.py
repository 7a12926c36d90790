"""The kind of recorded episodes, which are read as all touches are."""

from __future__ import annotations

from tactile_toolkit.kind import DatasetKind, lazy

KIND = DatasetKind(
    name="episodes",
    package="realtouch",  # opens every data set in the schema of touches
    noun="episode",
    nouns="episodes",
    content="episodes of environments",
    made_by="tactile-envs record",
    card_template="episodes.md",
    write_card=lazy("tactile_envs.episodes.recording:write_card"),
    needs=("sensor_image",),
    plan_previews=lazy("realtouch.touch_previews:plan_previews"),
    preview_spec="realtouch.touch_options:TouchPreviewSpec",
    plan_gallery=lazy("realtouch.touch_gallery:plan_gallery"),
    facts=lazy("tactile_envs.episodes.recording:facts"),
)
