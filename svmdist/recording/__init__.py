"""Reading and writing recordings; the sole importer of mcap, rosbags and protobuf.

`log` opens them for everything else. `mcap` and `rosbag` read files: bytes on disk to raw messages; `messages` and
`images` what these hold; `contents` and `observations` put it together over time.
"""
