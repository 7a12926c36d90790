"""``tactile``: what every data set can do, whatever its kind."""

from __future__ import annotations

from functools import partial

from cli import application, contents, copies, hub, pictures

app = application.new_app(
    "tactile",
    "Data sets of active tactile perception: show, check, copy and share them, whatever their kind. mnist3d, "
    "starstruck, realtouch, tactile-sim, env-assets and tactile-envs make and check data of one kind.",
)
application.command(app, "list", asks_hub=True)(contents.list_sets)
for _function in (
    *(contents.info, contents.show, contents.verify, pictures.preview, pictures.gallery),
    *(copies.select, copies.split, copies.merge, copies.export, copies.card),
    *(hub.upload, hub.download, copies.cache),
):
    application.command(app, asks_hub=_function is hub.upload)(_function)
main = partial(application.run, app)
