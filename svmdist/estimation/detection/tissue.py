"""The tissue in an image: its region, its completed outline, and its pose on the plane."""

from __future__ import annotations

from dataclasses import dataclass

from svmdist.camera import Camera
from svmdist.estimation.tissue.pose import TissuePose, require_tissue, tissue_pose
from svmdist.profile import Profile
from svmdist.vision.completion import CompletedOutline, complete_outline
from svmdist.vision.regions import Region, find_region
from svmdist.vision.segmentation.segmenter import Masks


@dataclass(frozen=True, slots=True)
class TissueDetection:
    """What an image shows of the tissue; `pose` is None where the outline's rays do not meet the plane."""

    region: Region
    outline: CompletedOutline
    pose: TissuePose | None


def detect_tissue(masks: Masks, profile: Profile, camera: Camera) -> TissueDetection | None:
    """Find the tissue in an image's masks and place it in 3D; None where no region passes the gate.

    Raises ProfileError where the profile knows no plane.
    """
    tissue = require_tissue(profile)
    # The region's own centroid would complete the outline a first time.
    rule = profile.segmentation.tissue.model_copy(update={"occlusion": "hull"})
    region = find_region(masks.tissue, rule, profile.settings.outline)
    if region is None:
        return None
    outline = complete_outline(masks.tissue, region.hull, profile.settings.outline)
    return TissueDetection(region, outline, tissue_pose(outline, camera, tissue))
