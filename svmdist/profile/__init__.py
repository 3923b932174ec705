"""The scene profile (TOML): what a recording shows and how to measure it, checked when it is read."""

from svmdist.profile.profile import (
    DEFAULT_PROFILE,
    SHIPPED,
    Features,
    Frames,
    Limits,
    Marker,
    Profile,
    Topics,
    load_profile,
    profile_path,
    shipped_profiles,
    stated_deviations,
)
from svmdist.profile.robot import (
    CameraError,
    Dome,
    EntrySide,
    Fiducial,
    Instrument,
    Joint,
    KinematicError,
    OtherInstrument,
    Placement,
    Robot,
    Simulation,
    Tissue,
)
from svmdist.profile.segmentation import (
    AreaGate,
    AutoSegmentation,
    ClassRegion,
    ColourRegion,
    HsvSegmentation,
    OnnxSegmentation,
    Segmentation,
)
