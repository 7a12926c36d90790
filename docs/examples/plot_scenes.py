"""
Starstruck scenes
=================

Scenes are computed on request. No file is written, and a seed gives the same scenes on every machine.
"""

import matplotlib.pyplot as plt

import starstruck_gen

scenes = starstruck_gen.SceneDataset(size=1_000_000, seed=0)

figure, axes = plt.subplots(1, 4, figsize=(8, 2.3), layout="constrained")
for cell, number in zip(axes, (0, 1, 123_456, 999_999), strict=True):
    cell.imshow(scenes[number].scene.draw())
    cell.set(title=f"scene {number:,}: {scenes[number].star_count}", xticks=[], yticks=[])
plt.show()

# %%
# More objects and other shapes, placed by their outlines instead of their circumscribed circles:

spec = starstruck_gen.SceneSpec(
    stars=(3, 4, 5),
    distractors=(4, 8),
    distractor_shapes=tuple(starstruck_gen.Shape(name, 0.008) for name in ("ring", "cross", "crescent")),
    collision="exact",
)
harder = starstruck_gen.SceneDataset(size=12, spec=spec, seed=1)
figure, axes = plt.subplots(1, 4, figsize=(8, 2.3), layout="constrained")
for cell, record in zip(axes, harder, strict=False):
    cell.imshow(record.scene.draw())
    cell.set(title=f"{record.star_count} stars", xticks=[], yticks=[])
plt.show()
