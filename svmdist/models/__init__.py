"""The networks that ship with svmdist, as ONNX files beside this one, and what a profile must say to run each."""

from __future__ import annotations

from pathlib import Path
from typing import Any

PREFIX = "svmdist:"
"""`model = "svmdist:NAME"` in a profile is a network of this folder."""

INSTRUMENTS: dict[str, Any] = {
    "width_px": 256,
    "height_px": 192,
    "channels": "bgr",
    "mean": (127.5, 127.5, 127.5),
    "scale": 1 / 127.5,
    "from_border": True,
    "tissue": {"class_ids": (1,), "min_area_px": 2000, "occlusion": "outline"},
    "instrument": {"class_ids": (2,), "min_area_px": 50},
    "shaft": {"class_ids": (3,), "min_area_px": 200},
}
"""Made by `training/train.py`, of pictures that are drawn there."""

SHIPPED = {"instruments": INSTRUMENTS}


def shipped_file(name: str) -> Path:
    """Where the network of that name is."""
    return Path(__file__).with_name(f"{name}.onnx")
