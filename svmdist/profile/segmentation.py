"""The part of a profile about segmentation: which pixels are tissue, instrument and shaft."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import Discriminator, Field, Tag, field_validator, model_validator

from svmdist.errors import did_you_mean
from svmdist.profile.robot import Vector
from svmdist.profile.toml import Byte, Hue, NeighbourFile, StrictModel

PREFIX = "svmdist:"  # of a `model` in a profile: a network of the package
SHIPPED = f"{PREFIX}instruments"
INSTRUMENTS: dict[str, Any] = {
    "width_px": 480,
    "height_px": 384,
    "channels": "bgr",
    "mean": (127.5, 127.5, 127.5),
    "scale": 1 / 127.5,
    "output": "scores",
    "crop_to_view": True,
    "from_border": True,
    "tissue": {"class_ids": (1,), "min_area_px": 2000, "occlusion": "outline"},
    "instrument": {"class_ids": (2,), "min_area_px": 50},
    "shaft": {"class_ids": (3,), "min_area_px": 200},
}
"""What a profile must say to run the network that `training/train.py` makes, of pictures that are rendered there."""


class AreaGate(StrictModel):
    """Which parts of a mask are a region, and where its centroid is: the same for every way to segment."""

    min_area_px: int = Field(ge=1)
    components: Literal["all", "largest"] = "all"  # that count: an instrument across an organ cuts its region in two
    occlusion: Literal["none", "hull", "outline"] = "none"  # centroid of visible pixels, their hull, a fitted outline


class ColourRegion(AreaGate):
    """An HSV box in OpenCV's 8-bit units (H 0–179, S and V 0–255), bounds included, and its area gate."""

    hue: tuple[Hue, Hue]  # with first > last it wraps around 0, as red does
    saturation: tuple[Byte, Byte] = (0, 255)
    value: tuple[Byte, Byte] = (0, 255)

    def _require_sound(self) -> None:
        for name, (first, last) in (("saturation", self.saturation), ("value", self.value)):
            if first > last:
                raise ValueError(f"{name} = [{first}, {last}] is empty: the first bound is above the last")


class ClassRegion(AreaGate):
    """Classes of a segmentation network that make up a region, and its area gate."""

    class_ids: tuple[Annotated[int, Field(ge=0)], ...] = Field(min_length=1)


Method = Literal["hsv", "onnx", "auto"]


class HsvSegmentation(StrictModel):
    """Tissue and instrument found by their colours."""

    method: Method = "hsv"
    tissue: ColourRegion
    instrument: ColourRegion
    shaft: ColourRegion | None = None  # dark, from the border on; the method `shaft` looks for it


class OnnxSegmentation(StrictModel):
    """Tissue and instrument found by a network of the user's own, in an ONNX file.

    Its input is one image of shape (1, 3, h, w) and type float32, (pixel - `mean`) * `scale` with pixels from 0 to
    255. Its output is class scores of shape (1, C, h', w'), C >= 2, or labels of shape (1, 1, h', w') or (1, h', w').
    """

    method: Method
    model: NeighbourFile
    """The ONNX file; a relative path starts from the profile's folder. `svmdist:instruments` is the network that ships,
    for which all that follows has a default."""
    width_px: int = Field(ge=8, le=4096)  # of the network's input; the image is stretched to it
    height_px: int = Field(ge=8, le=4096)
    channels: Literal["rgb", "bgr"] = "rgb"
    mean: Vector = (0.0, 0.0, 0.0)  # subtracted from each channel, in the order of `channels`
    scale: Vector = (1 / 255, 1 / 255, 1 / 255)  # that each channel is then multiplied by; one number serves all three
    output: str | None = None  # name of the output to take; None: the only one
    crop_to_view: bool = False  # give the network only the box around the endoscope's view, no black border
    from_border: bool = False  # leave out parts of instruments that do not reach the border of the picture
    tissue: ClassRegion
    instrument: ClassRegion
    shaft: ClassRegion | None = None

    @model_validator(mode="before")
    @classmethod
    def _shipped(cls, data: Any) -> Any:
        model = data.get("model") if isinstance(data, dict) else None
        if not isinstance(model, str) or not model.startswith(PREFIX):
            return data
        if model != SHIPPED:
            raise ValueError(f"model = {model!r}: no such network ships: {did_you_mean(model, [SHIPPED])}")
        return {**INSTRUMENTS, **data, "model": Path(__file__).parent.with_name("models") / "instruments.onnx"}

    @field_validator("scale", mode="before")
    @classmethod
    def _for_each_channel(cls, scale: Any) -> Any:
        return (scale, scale, scale) if isinstance(scale, int | float) else scale

    def _require_sound(self) -> None:
        if 0.0 in self.scale:
            raise ValueError("scale must not be 0: the network would see nothing")
        if both := sorted(set(self.tissue.class_ids) & set(self.instrument.class_ids)):
            raise ValueError(f"class {both[0]} cannot be tissue and instrument at once")

    @property
    def parts(self) -> dict[str, ClassRegion]:
        """The regions by their names in the profile."""
        named = {"tissue": self.tissue, "instrument": self.instrument, "shaft": self.shaft}
        return {name: region for name, region in named.items() if region is not None}


class AutoSegmentation(StrictModel):
    """Tissue and instruments found without a colour from the user; `[settings.auto]` holds what it assumes."""

    method: Method
    tissue: AreaGate = AreaGate(min_area_px=2000, occlusion="outline")
    instrument: AreaGate = AreaGate(min_area_px=50)
    shaft: AreaGate | None = AreaGate(min_area_px=200)


Segmentation = HsvSegmentation | OnnxSegmentation | AutoSegmentation


def _method_of(value: Any) -> str:
    """The union's tag of a table or a model; the model of colours reports what is neither."""
    method = value.get("method") if isinstance(value, dict) else getattr(value, "method", None)
    return f"({method if method in get_args(Method) else 'hsv'})"


AnySegmentation = Annotated[
    Annotated[HsvSegmentation, Tag("(hsv)")]
    | Annotated[OnnxSegmentation, Tag("(onnx)")]
    | Annotated[AutoSegmentation, Tag("(auto)")],
    Discriminator(_method_of),
]
