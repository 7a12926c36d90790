"""The twin of a sensor: fitted to touches of known solids, it renders images and reads depth from images."""
