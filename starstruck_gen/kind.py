"""What the rest of the toolkit must know of data sets of Starstruck scenes."""

from __future__ import annotations

from tactile_toolkit.kind import DatasetKind, lazy, tactile_mnist_set

KIND = DatasetKind(
    name="starstruck",
    command="starstruck",
    package="starstruck_gen",
    noun="scene",
    nouns="scenes",
    made_by="starstruck generate",
    card_template="starstruck.md",
    write_card=lazy("starstruck_gen.card:write_card"),
    schema=lazy("starstruck_gen.columns:scene_schema"),
    class_names=("1", "2", "3"),  # Tactile MNIST paper, section Starstruck
    columns=("star_count",),
    splits=("train", "test"),
    published=(tactile_mnist_set("starstruck", "starstruck", "3,300 scenes with one to three stars"),),
    plan_previews=lazy("starstruck_gen.previews:plan_previews"),
    plan_gallery=lazy("starstruck_gen.gallery:plan_gallery"),
    recipe=lazy("starstruck_gen.make:scene_recipe"),
)
