"""svmdist: the distance between a surgical instrument and tissue, estimated from recorded logs.

The functions to call are in `svmdist.workflows`; a recording is opened by
`svmdist.recording.reader.open_recording`, and `svmdist.workflows.setup.prepare` makes what a measurement
needs. The command line is `svmdist.cli`.
"""
