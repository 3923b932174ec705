"""What the network takes and gives, as the profile's `[segmentation]` says it."""

from __future__ import annotations

from pathlib import Path

from svmdist.models import INSTRUMENTS
from svmdist.profile import OnnxSegmentation


def network_rules(model: Path, *, from_border: bool = True) -> OnnxSegmentation:
    """The profile's rules for a file of `training.train`: those of the network that ships."""
    return OnnxSegmentation.model_validate(
        {**INSTRUMENTS, "method": "onnx", "model": model, "from_border": from_border}
    )
