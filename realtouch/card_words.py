"""What the cards of touches say beside their numbers: columns, frames, limits, terms."""

from __future__ import annotations

from dataset_store.cards.parts import Column

__all__ = [
    "COLUMNS",
    "FAMILIES",
    "FRAMES",
    "INDEX_COLUMNS",
    "LIMITS",
    "PRINTABILITY",
    "SYNTHETIC_COLUMNS",
]

_CELL = "m, cell frame"

COLUMNS: dict[str, Column] = {
    "id": ("", "name of the round, unique over all splits"),
    "label": ("", "class of the touched object"),
    "object_id": ("", "`id` of its mesh in MNIST 3D"),
    "pos_in_cell": (f"T x 2, {_CELL}", "intended positions"),
    "plate_z_m": (_CELL, "height of the plate, from all touches of the round as it was recorded"),
    "gel_pose_cell_frame.position": (f"T x 3, {_CELL}", "position of the gel at contact"),
    "gel_pose_cell_frame.quaternion": ("T x 4: x, y, z, w", "its orientation"),
    "gel_pose_cell_frame_seq.position": (
        f"T x N x 3, {_CELL}",
        "position of the gel in each frame; cut to N_i",
    ),
    "gel_pose_cell_frame_seq.quaternion": ("T x N x 4: x, y, z, w", "its orientation; cut to N_i"),
    "video_length_frames": ("T, frames", "N_i, the length of each clip"),
    "time_stamp_rel_seq": ("T x N, time since the clip's start", "time of each frame; cut to N_i"),
    "touch_start_time_rel": ("T, time since the clip's start", "first registered contact"),
    "touch_end_time_rel": ("T, time since the clip's start", "last registered contact"),
    "sensor_video": ("T clips, AVI of MJPEG frames", "what the sensor saw"),
    "sensor_image": ("T images, JPEG", "what the sensor saw at contact"),
    "info.gel_id": ("", "which gel pad was on the sensor"),
    "info.notes": ("", "notes of the recording"),
    "info.object_pose.position": (_CELL, "position of the object, for the round or for each touch"),
    "info.object_pose.quaternion": ("x, y, z, w", "its orientation"),
}

SYNTHETIC_COLUMNS: dict[str, Column] = {
    **COLUMNS,
    "object_id": ("", "`id` of the mesh of the touched object, in the data set that it comes from"),
}

FAMILIES: dict[str, Column] = {"info.": ("", "metadata of the round, as recorded")}

INDEX_COLUMNS: dict[str, Column] = {
    "id": ("", "round and touch"),
    "file": ("", "the picture, from the folder of the data set"),
    "sha256": ("hexadecimal", "checksum of the file"),
    "round_id": ("", "name of the round"),
    "touch": ("", "number of the touch in its round, from 0"),
    "frame": ("", "number of the frame in its clip, 0 for single images"),
    "label": ("", "class of the touched object"),
    "object_id": ("", "`id` of the mesh of the touched object"),
    **{f"pos_in_cell_{axis}_m": (_CELL, f"intended position, {axis}") for axis in "xy"},
    **{f"gel_{axis}_m": (_CELL, f"position of the gel, {axis}") for axis in "xyz"},
    **{f"gel_q{axis}": ("", f"orientation of the gel, quaternion's {axis}") for axis in "xyzw"},
}

FRAMES = """\
```
   cell frame, seen from above                image of the sensor

          y, away from the robot                0 ---------> column, along +x of the gel
          ^                                     |
   +------|------+                              |   18.88 x 14.16 mm of gel
   |      |      |                              |
   |      o------|--> x, right of the robot     v
   |             |                              row, along -y of the gel
   +-------------+
     z points up, out of the page
```

Cell frame: origin at the centre of the 120 x 120 mm cell; metres; right-handed. Poses are those of the gel
in this frame; quaternions are x, y, z, w. The zero of z drifts by up to 3 mm between rounds: take the
deepest touch of a round as the plate, or `plate_z_m` where that column is there."""

_COMMON = (
    "The pose of the gel is that of the arm; an object may have moved a little while it was touched.",
    "Force is estimated from the arm's joints: 5 N are not the same at every place of the cell.",
    "The gel pad was replaced halfway through the recordings; `info.gel_id`, where it is there, tells which.",
    "Many touches meet no object but the mat; filter them with `realtouch select --contact`.",
)

LIMITS: dict[str, tuple[str, ...]] = {
    "seq": (*_COMMON, "Frames are JPEG with coarser colour than brightness; decoders differ by some levels."),
    "single": (*_COMMON, "Images are JPEG; what compression lost is lost."),
    "frames": _COMMON,
    "synthetic": (
        "Rendered images lack the texture of prints, the wear of gels and the shift of objects.",
        "Touch i was rendered against the object pose of touch i - 1 in the published sets.",
        "Many touches meet no object; filter them with `realtouch select --contact`.",
    ),
}

PRINTABILITY = {
    "real": """\
`object_id` is the `id` of the touched object's mesh in its own data set: for the real touches MNIST 3D, whose
splits `printed_train` and `printed_test` were printed, and whose report tells height, walls and volume.""",
    "synthetic": """\
Nothing was printed: the objects are meshes. `object_id` is the `id` of the mesh in its data set.""",
}
