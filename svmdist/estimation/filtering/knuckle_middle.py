"""Where the middle of the coloured knuckle is in an image, as blur and perspective leave it."""

from __future__ import annotations

from svmdist.camera import Camera
from svmdist.estimation.instrument.shaft_sight import knuckle_disc
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.regions import Region


def knuckle_middle(
    image_hsv: Image, mask: Image, region: Region, camera: Camera, depth_m: float, radius_m: float
) -> tuple[Array, float]:
    """The pixel (2,) of the middle of a sphere of `radius_m` at `depth_m`, and the blur of its border in px.

    The image is one at a fair exposure; `mask`, shape (h, w), holds the region. Blur moves a threshold's border to
    the side of what the colour mixes with, the place of half its strength hardly. Where that is not to be found, or of
    a tip that is no sphere (`radius_m` 0), it is the region's centroid, of blur 0.
    """
    disc = knuckle_disc(image_hsv, mask, region) if radius_m > 0.0 else None
    if disc is None:
        return region.centroid_px, 0.0
    return without_perspective(disc.centre_px, camera, depth_m, radius_m), disc.blur_px


def without_perspective(middle_px: Array, camera: Camera, depth_m: float, radius_m: float) -> Array:
    """The pixel (2,) of a sphere's centre from the middle of its outline.

    The tangents to a sphere at (X, 0, Z) meet z = 1 about X Z / (Z² - r²), not about X / Z.
    """
    if depth_m <= radius_m:
        return middle_px
    aside = (radius_m / depth_m) ** 2
    return middle_px - aside * (middle_px - camera.K[:2, 2])
