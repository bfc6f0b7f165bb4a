"""The type of a frame of H.264 or H.265, which is Foxglove's and not among Jazzy's own."""

from __future__ import annotations

VIDEO_TYPE = "foxglove_msgs/msg/CompressedVideo"

# The fields of the releases for ROS 2; drafts append others, which readers here pass over.
VIDEO_DEFINITION = """\
# One frame of a video; it can be decoded when all frames since the last keyframe are known.
builtin_interfaces/Time timestamp   # of the picture
string frame_id                     # optical frame of the camera: x right, y down, z ahead
uint8[] data                        # H.264, H.265: Annex B, one whole picture, no B-frames;
                                    # each keyframe brings its parameter sets with it
string format                       # h264, h265, vp9 or av1
"""
