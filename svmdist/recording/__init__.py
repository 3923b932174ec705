"""Reading and writing recordings; the sole importer of mcap and protobuf."""
