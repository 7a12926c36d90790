"""What the cards of exported touches say of their layout."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["EXPORTS", "ExportText"]


@dataclass(frozen=True, slots=True)
class ExportText:
    """Words of a card: a title, one sentence, what lies where, and how it is read."""

    title: str
    summary: str
    content: str
    loading: str
    size_note: str = "Parquet is the size of the index, unpacked that of its rows in memory."

    def words(self, first_split: str) -> dict[str, str]:
        """Return what the template of the card is filled with."""
        return {
            "layout_text": self.summary,
            "content_text": self.content,
            "loading": self.loading.replace("$first_split", first_split),
            "size_note": self.size_note,
        }


# What a foreign folder needs to be verified and resumed lies in `data`, so that it stays as its readers know
# it.
_INDEX = "is the index: it names the files of each shard with their checksums, and what stands in them."

EXPORTS = {
    "flat": ExportText(
        "Touches, one row each",
        "Parquet with one row a touch: the image as it was stored, and plain columns.",
        "One image for each touch: that of a single set, or one frame of a clip.",
        """\
```python
import datasets

touches = datasets.load_dataset("FOLDER", split="$first_split")
print(touches[0]["image"].size, touches[0]["label"])
```

With pandas (`polars.read_parquet` does the same):

```python
import io

import pandas
from PIL import Image

touches = pandas.read_parquet("FOLDER/data", columns=["image", "label", "gel_z_m"])
picture = Image.open(io.BytesIO(touches.image[0]["bytes"]))
```""",
        size_note="",
    ),
    "webdataset": ExportText(
        "Touches as WebDataset",
        "Tars for sequential reading: an image and a JSON file for each touch.",
        f"`webdataset/SPLIT-NUMBER.tar` hold the touches; `data/` {_INDEX}",
        """\
```python
import webdataset

tars = "FOLDER/webdataset/$first_split-{000000..LAST}.tar"  # LAST: the number of the last one
for image, fields in webdataset.WebDataset(tars, shardshuffle=False).decode("rgb").to_tuple("jpg", "json"):
    print(image.shape, fields["label"])
```""",
    ),
    "lerobot": ExportText(
        "Touches as LeRobotDataset",
        "A LeRobotDataset v3.0 with images: one clip an episode, or one round of single images.",
        f"""\
`lerobot/` is the data set, complete in itself; `data/` {_INDEX}

`observation.state` is the pose of the gel, `action` the intended position in the cell. Timestamps are those
of the frame rate in `meta/info.json` (of single images, one touch a second); `time_s` is the recorded time of
each frame. Statistics of images are those of 8 images of each episode.""",
        """\
```python
from lerobot.datasets.lerobot_dataset import LeRobotDataset

touches = LeRobotDataset("me/touches", root="FOLDER/lerobot")
print(touches.num_episodes, touches[0]["observation.images.tactile"].shape)
```""",
    ),
}
