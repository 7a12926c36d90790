"""
Touch a digit
=============

A simulated GelSight Mini is pressed onto four places of a digit. The depth images show how far the gel is
pressed in. Taxim turns depth into the colours that the camera behind the gel would see.
"""

import matplotlib.pyplot as plt
import numpy as np

import mnist3d
import tactile_sim
from mnist3d.sources.synthetic import SyntheticSource

mesh = mnist3d.solidify(SyntheticSource(seed=0).image(1234).pixels)
solid = tactile_sim.Pressable.of(mesh)
sensor = tactile_sim.full_view(320, 240)
places_m = [(0.0, 0.012), (0.012, 0.0), (0.0, -0.008), (-0.012, -0.016)]

on_the_plate = tactile_sim.pose(z_m=-solid.foot_m)
pressed = [
    tactile_sim.render_touch(solid, on_the_plate, tactile_sim.pose(*place), sensor) for place in places_m
]
depth_m = np.stack([each.depth_m for each in pressed])

figure, axes = plt.subplots(2, 4, figsize=(8, 3.6), layout="constrained")
for row, name in zip(axes, ("depth", "taxim"), strict=True):
    pictures = tactile_sim.make_optics(name).render(depth_m, sensor, (320, 240))
    for each, picture, place in zip(row, pictures, places_m, strict=True):
        each.imshow(picture)
        each.set(xticks=[], yticks=[])
        each.set_title(f"{1e3 * place[0]:g}, {1e3 * place[1]:g} mm", fontsize=9)
    row[0].set_ylabel(name)
plt.show()
