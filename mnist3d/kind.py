"""Facts about data sets of digits for the rest of the toolkit."""

from __future__ import annotations

from tactile_toolkit.kind import DatasetKind, lazy, tactile_mnist_set

KIND = DatasetKind(
    name="mnist3d",
    package="mnist3d",
    noun="digit",
    nouns="digits",
    made_by="mnist3d generate",
    card_template="mnist3d.md",
    write_card=lazy("mnist3d.digit_card:write_card"),
    schema=lazy("mnist3d.digit_records:digit_schema"),
    class_names=tuple(map(str, range(10))),
    columns=("writer",),
    splits=("train", "test", "holdout", "printed_train", "printed_test"),
    # Counts here and in the other kinds: Tactile MNIST paper and the documentation of the published loaders.
    published=(tactile_mnist_set("mnist3d", "mnist3d", "13,580 meshes of digits in 5 splits"),),
    plan_previews=lazy("mnist3d.digit_previews:plan_previews"),
    preview_spec="mnist3d.digit_options:DigitPreviewSpec",
    facts=lazy("mnist3d.digit_card:facts"),
    check_content=lazy("mnist3d.digit_checks:check_content"),
    plan_gallery=lazy("mnist3d.digit_previews:plan_gallery"),
    dataset=lazy("mnist3d:DigitDataset"),
    default_set=lazy("mnist3d.digit_generation:default_set"),
)
