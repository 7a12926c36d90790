"""What other packages need to know about data sets of touches."""

from __future__ import annotations

from tactile_toolkit.kind import DatasetKind, lazy, tactile_mnist_set

_REAL = (
    ("real-seq", "touch-real-seq-t256-320x240", "153,600 clips of touches of printed digits, 320 x 240 px"),
    (
        "real-single-320x240",
        "touch-real-single-t256-320x240",
        "153,600 images of touches of printed digits, 320 x 240 px",
    ),
    (
        "real-single-64x64",
        "touch-real-single-t256-64x64",
        "153,600 images of touches of printed digits, 64 x 64 px",
    ),
)
_ALIASES = {"real-single-320x240": ("real-single",)}
_RENDERED = tuple(
    (
        f"{prefix}syn-single-{width}x{height}",
        f"touch-{prefix}syn-single-t32-{width}x{height}",
        f"rendered touches of {things}, 32 per round, {width} x {height} px",
    )
    for prefix, things in (("", "digits"), ("starstruck-", "scenes"))
    for width, height in ((320, 240), (64, 64))
)
# Files next to `data` that belong to the data set, for `verify` and `upload`.
_EXCHANGED = (
    "webdataset/*.tar",
    "lerobot/data/*/*.parquet",
    "lerobot/meta/*",
    "lerobot/meta/*/*/*.parquet",
    "fota/*/data-*.tar",
    "minari/*/*/data/main_data.hdf5",
    "minari/*/*/data/metadata.json",
    "fota/*/count.txt",
    "anytouch/*_bg.txt",
    "oxt/touches.zarr.zip",
    "replay/touches.zarr.zip",
    "anytouch/touch_and_go/*/gelsight_frame/*.jpg",
)


KIND = DatasetKind(
    name="realtouch",
    package="realtouch",
    noun="round",
    nouns="rounds",
    content="touches",
    made_by="tactile select",
    card_template="touch_{}.md",
    write_card=lazy("realtouch.touch_card:write_card"),
    check=lazy("realtouch.checks.verification:list_findings"),
    columns=("sensor_image", "sensor_video"),
    splits=("train", "test"),
    needs=("sensor_image", "sensor_video"),
    needs_manifest=False,
    extra_files=("images/*/*/*.png", "images/*/*/*.jpg", "index.csv", *_EXCHANGED),
    published=(
        *(
            tactile_mnist_set(*entry, licence="CC BY 2.0", aliases=_ALIASES.get(entry[0], ()))
            for entry in _REAL
        ),
        *(tactile_mnist_set(*entry) for entry in _RENDERED),
    ),
    plan_previews=lazy("realtouch.touch_previews:plan_previews"),
    preview_spec="realtouch.touch_options:TouchPreviewSpec",
    plan_gallery=lazy("realtouch.touch_gallery:plan_gallery"),
)
