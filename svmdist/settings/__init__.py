"""What detectors and estimators may assume, as frozen settings: the tables `[settings.NAME]` of a profile."""

from __future__ import annotations

from svmdist.settings.association import AssociationSettings
from svmdist.settings.auto import AutoSettings
from svmdist.settings.distal_marker import DistalMarkerSettings
from svmdist.settings.exposure import ExposureSettings
from svmdist.settings.filter import FilterSettings
from svmdist.settings.fused import FusedSettings
from svmdist.settings.interlace import InterlaceSettings
from svmdist.settings.marker import MarkerSettings
from svmdist.settings.outline import OutlineSettings
from svmdist.settings.shaft import ShaftSettings
from svmdist.settings.stereo import StereoSettings
from svmdist.settings.tag import TagSettings
from svmdist.settings.tissue import TissueTrackingSettings
from svmdist.toml_model import StrictModel


class Settings(StrictModel):
    """All settings, a group for each detector or estimator; a profile may set any of them."""

    interlace: InterlaceSettings = InterlaceSettings()
    exposure: ExposureSettings = ExposureSettings()
    auto: AutoSettings = AutoSettings()
    outline: OutlineSettings = OutlineSettings()
    marker: MarkerSettings = MarkerSettings()
    shaft: ShaftSettings = ShaftSettings()
    distal_marker: DistalMarkerSettings = DistalMarkerSettings()
    stereo: StereoSettings = StereoSettings()
    tag: TagSettings = TagSettings()
    filter: FilterSettings = FilterSettings()
    fused: FusedSettings = FusedSettings()
    association: AssociationSettings = AssociationSettings()
    tissue: TissueTrackingSettings = TissueTrackingSettings()
