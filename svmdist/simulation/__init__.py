"""The simulated surgical robot and its scene; the sole importer of PyBullet."""
