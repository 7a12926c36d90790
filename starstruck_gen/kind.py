"""Facts about data sets of Starstruck scenes for the rest of the toolkit."""

from __future__ import annotations

from tactile_toolkit.kind import DatasetKind, lazy, tactile_mnist_set

KIND = DatasetKind(
    name="starstruck",
    package="starstruck_gen",
    noun="scene",
    nouns="scenes",
    made_by="starstruck generate",
    card_template="starstruck.md",
    write_card=lazy("starstruck_gen.scene_card:write_card"),
    schema=lazy("starstruck_gen.scene_dataset:published_schema"),
    class_names=("1", "2", "3"),  # Tactile MNIST paper, section Starstruck
    columns=("star_count",),
    splits=("train", "test"),
    published=(tactile_mnist_set("starstruck", "starstruck", "3,300 scenes with one to three stars"),),
    preview_spec="starstruck_gen.scene_options:ScenePreviewSpec",
    facts=lazy("starstruck_gen.scene_card:facts"),
    check_content=lazy("starstruck_gen.scene_checks:check_content"),
    plan_gallery=lazy("starstruck_gen.scene_card:plan_gallery"),
    dataset=lazy("starstruck_gen:SceneMeshDataset"),
    default_set=lazy("starstruck_gen.scene_dataset:default_set"),
)
