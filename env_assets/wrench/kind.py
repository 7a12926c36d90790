"""Everything that other packages need to know about data sets of a wrench."""

from __future__ import annotations

from tactile_toolkit.kind import DatasetKind, lazy

KIND = DatasetKind(
    name="wrench",
    command="env-assets",
    package="env_assets.wrench.records",
    noun="wrench",
    nouns="wrenches",
    made_by="env-assets wrench",
    card_template="wrench.md",
    write_card=lazy("env_assets.wrench.dataset:write_card"),
    schema=lazy("env_assets.wrench.dataset:wrench_schema"),
    class_names=("wrench",),
    columns=("opening_mm",),
    missing_commands=(
        *("info", "validate", "preview", "card", "upload", "download", "gallery", "list", "select"),
    ),
    dataset=lazy("env_assets:WrenchDataset"),
    recipe=lazy("env_assets.wrench.dataset:wrench_recipe"),
)
