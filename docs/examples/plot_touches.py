"""
Touch a digit
=============

A simulated GelSight Mini is pressed onto a digit at four positions. The depth images show how far the gel is
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
positions_m = [(0.0, 0.012), (0.012, 0.0), (0.0, -0.008), (-0.012, -0.016)]

on_the_plate = tactile_sim.pose(z_m=-solid.foot_m)
pressed = [
    tactile_sim.render_touch(solid, on_the_plate, tactile_sim.pose(x_m, y_m), sensor)
    for x_m, y_m in positions_m
]
depth_m = np.stack([touch.depth_m for touch in pressed])

figure, axes = plt.subplots(2, 4, figsize=(8, 3.6), layout="constrained")
for row_axes, name in zip(axes, ("depth", "taxim"), strict=True):
    pictures = tactile_sim.make_optics(name).render(depth_m, sensor, (320, 240))
    for cell, picture, (x_m, y_m) in zip(row_axes, pictures, positions_m, strict=True):
        cell.imshow(picture)
        cell.set(xticks=[], yticks=[])
        cell.set_title(f"{1e3 * x_m:g}, {1e3 * y_m:g} mm", fontsize=9)
    row_axes[0].set_ylabel(name)
plt.show()
