"""Perturbations of what the cameras see: lens, tissue, the looks of the instrument, video, light.

`svmdist/simulation/room/` draws them. Few can be done to images that are recorded already.
"""

from __future__ import annotations

from svmdist.perturbations.laws import Always, Law, Uniform
from svmdist.perturbations.perturbation import Perturbation, Place

MARKER = "the coloured part is what the set-up adds, as the paper has it: it wears, and stays"
TOOLS = "Bouget et al. 2017; Allan et al. 2019: what instruments in operations look like"
PRESSED = "Liu et al. 2007; Samur et al. 2007: instruments press livers in by millimetres; how far is assumed"
BREATH = "Richa, Bó & Poignet 2011: breathing and heartbeat move what is operated on by millimetres"
VIDEO = "ITU-R BT.601: first-generation endoscopes give 4:2:2 fields; recorders keep 4:2:0 (ITU-T H.264)"
TIP = "Collins & Bartoli 2012; Okatani & Deguchi 1997: the endoscope carries the light"


def _image(
    name: str, unit: str, meaning: str, high: float, real: Law | None, source: str, at_replay: bool = False
) -> Perturbation:
    return Perturbation(name, unit, Place.IMAGES, meaning, 0.0, high, real, source, at_replay=at_replay)


IMAGES: tuple[Perturbation, ...] = (
    _image(
        "lens",
        "times",
        "Distortion of both lenses, times k1 = -0.2, k2 = 0.05; camera_info tells it (D, plumb_bob).",
        1.25,
        Uniform(0.5, 1.2),
        "after Barreto et al. 2009 and Zhang 2000: endoscopes bend lines towards barrels",
    ),
    _image(
        "lens_untold",
        "times",
        "Further distortion of both lenses, as for lens, which camera_info does not tell.",
        1.25,
        Uniform(0.0, 0.01),
        "after Zhang 2000: what calibration leaves, half a pixel in the corners",
    ),
    _image(
        "breathing",
        "mm",
        "Amplitude at 0.25 Hz by which tissue and floor move along the plane's normal.",
        10.0,
        Uniform(1.0, 3.0),
        BREATH,
    ),
    _image(
        "pulse",
        "mm",
        "Amplitude at 1.2 Hz by which tissue and floor move along the plane's normal.",
        5.0,
        Uniform(0.0, 0.5),
        BREATH,
    ),
    _image(
        "tissue_shape",
        "of the height",
        "Random waves of 14 to 32 mm multiply the organ's height, a fifth of it the outline's radius.",
        0.5,
        Uniform(0.05, 0.25),
        "assumed: no organ is of the profile's family",
    ),
    _image(
        "tissue_ellipsoid",
        "of the way",
        "From the profile's dome, 0, to an ellipsoid, 1, and beyond.",
        1.5,
        Uniform(0.0, 1.0),
        "assumed: no organ is of the profile's family",
    ),
    _image(
        "dent",
        "mm",
        "Tissue gives way to what presses on it, and `contact` goes so much deeper than a touch.",
        4.0,
        Uniform(0.5, 2.5),
        PRESSED,
    ),
    _image(
        "tip", "of the way", "From the coloured part, 0, to bare steel, 1.", 1.0, Uniform(0.0, 0.2), MARKER
    ),
    _image(
        "ring",
        "mm",
        "The coloured part is a ring so far behind the tool's origin, which is bare steel.",
        8.0,
        None,
        "",
    ),
    _image("shaft_grey", "of the way", "From the dark shaft to a grey one.", 1.0, Uniform(0.0, 0.3), TOOLS),
    _image("shaft_blue", "of the way", "From the dark shaft to a blue one.", 1.0, None, ""),
    _image(
        "jaw",
        "deg",
        "The jaws open up to so much further, at 0.3 Hz, than is reported.",
        45.0,
        Uniform(0.0, 5.0),
        "Haghighipanah et al. 2015: cable stretch, most in the wrist",
    ),
    _image(
        "blood",
        "of the surface",
        "Red patches that stay on the instrument's parts, the tag among them.",
        0.9,
        Uniform(0.0, 0.15),
        TOOLS,
    ),
    _image(
        "border",
        "of the way",
        "Round black border: at 0 it touches the corners, at 1 the left and right side.",
        1.5,
        Uniform(0.0, 0.6),
        "Münzer et al. 2018; Budd et al. 2022: scopes with rod lenses show a circle",
        at_replay=True,
    ),
    _image(
        "vignette",
        "of the light",
        "What the corners lack.",
        0.95,
        Uniform(0.1, 0.4),
        "Kang & Weiss 2000: off-axis light falls with the fourth power of the cosine, and vignetting adds to it",
        at_replay=True,
    ),
    _image(
        "chroma",
        "of the way",
        "Colour at half the resolution (4:2:0).",
        1.0,
        Always(1.0),
        VIDEO,
        at_replay=True,
    ),
    _image(
        "interlace",
        "1/60 s",
        "Odd rows show everything so much later than even ones.",
        6.0,
        Always(1.0),
        VIDEO,
    ),
    _image(
        "rolling",
        "ms",
        "Rows are exposed one after another, the last one so much later than the first; the stamp is the middle row's.",
        100.0,
        None,
        "",
    ),
    _image(
        "light",
        "of the way",
        "From a far lamp to one at the endoscope's tip, whose light falls with the distance squared.",
        1.0,
        Always(1.0),
        TIP,
    ),
    _image(
        "shadow",
        "of the light",
        "What instruments keep of the lamp's light from tissue and floor.",
        1.0,
        Uniform(0.5, 1.0),
        TIP,
    ),
    _image(
        "wet",
        "times",
        "Highlights of the lamp on wet tissue, which move with the eye.",
        3.0,
        Uniform(0.5, 1.5),
        "Arnold et al. 2010: tissue is wet, and its highlights saturate",
    ),
)
