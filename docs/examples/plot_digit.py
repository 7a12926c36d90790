"""
From ink to a solid
===================

An image of a digit becomes a closed, printable mesh. The height map shows the mesh from above. Its shoulders
are round, because each layer is a little smaller than the one below it.
"""

import matplotlib.pyplot as plt

import env_assets
import mnist3d
from mnist3d.sources.synthetic import SyntheticSource

image = SyntheticSource(seed=0).image(1234)
mesh = mnist3d.solidify(image.pixels)
heights = env_assets.top_surface(mesh, pitch_m=0.0002)

figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3.6), layout="constrained", sharex=True, sharey=True)
left.imshow(image.pixels, cmap="gray", extent=(-50, 50, -50, 50))
left.set(title="ink", xlabel="x, mm", ylabel="y, mm")
drawn = right.pcolormesh(1e3 * heights.x_m, 1e3 * heights.y_m, 1e3 * heights.heights_m)
right.set(title="solid", xlabel="x, mm", aspect="equal")
figure.colorbar(drawn, label="height over the plate, mm")
plt.show()

# %%
# Properties that matter for printing:

report = mnist3d.inspect(mesh)
print(f"{report.volume_mm3:,.0f} mm³, thinnest wall {report.thinnest_wall_mm:.1f} mm")
print("warnings:", ", ".join(report.warnings) or "none")
