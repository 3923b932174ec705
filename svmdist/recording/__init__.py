"""Reading and writing recordings; the sole importer of mcap and protobuf.

`mcap_file/` and `rosbag/` read files: bytes on disk to raw messages. `messages/` reads and writes what the
messages hold: bytes of a message to samples and back. The modules beside them are what the rest of svmdist uses.
"""
