"""Ways in which the world is not what logs and profiles state, for `record` and for replay alike.

`table.py` declares every perturbation, `chosen.py` holds those of a run. The other modules apply them to what a robot
reports (`joints.py`), to what log and profile state (`calibration.py`), and to images (`images.py`).
"""
