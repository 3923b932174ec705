"""What the world may have other than logs and profiles say: one table, for `record` and for replay alike.

`table.py` declares every perturbation; `chosen.py` holds which of them a run has. The other modules apply them:
`joints.py` and `clock.py` to what a robot reports, `calibration.py` to what a log says of its cameras, `shape.py` to
what a profile says of instrument, tag and plane.
"""
