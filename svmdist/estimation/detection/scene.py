"""The images of one moment, each looked at once, and what they show that belongs to no single instrument."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from svmdist.estimation.detection.lazy import CostLedger, detected
from svmdist.profile import Profile
from svmdist.results import Failure
from svmdist.samples import Observation
from svmdist.transforms import Array
from svmdist.vision.frame_context import FrameContext
from svmdist.vision.interlace import with_first_fields
from svmdist.vision.segmentation.segmenter import Segmenter
from svmdist.vision.undistortion import as_pinholes

if TYPE_CHECKING:  # each detection imports its detector when it is first asked for
    from svmdist.estimation.detection.stereo_surface import StereoSurface
    from svmdist.estimation.detection.tissue import TissueDetection
    from svmdist.vision.rectified import RectifiedPair


class Scene:
    """One moment of a log before the instruments are told apart; all methods and instruments share its detections.

    Its `observation` is what ideal cameras would have seen; `lens` is the left camera as it is. `row_offset_px`
    is by how much the right view's rows lie below the left one's.
    """

    def __init__(
        self,
        observation: Observation,
        profile: Profile,
        segmenter: Segmenter,
        ledger: CostLedger | None = None,
        row_offset_px: float = 0.0,
    ) -> None:
        self.lens = observation.camera
        recorded = observation
        observation = with_first_fields(observation, profile.settings.interlace)
        self.is_interlaced = observation is not recorded
        self.observation = observation = as_pinholes(observation, row_offset_px)
        self.ledger = ledger or CostLedger()
        self.found: dict[str, Any] = {}
        self._profile = profile
        exposure = profile.settings.exposure
        self.left = FrameContext(observation.image_bgr, segmenter, exposure)
        right = observation.right
        self.right = None if right is None else FrameContext(right.image_bgr, segmenter, exposure)

    @detected
    def tissue(self) -> TissueDetection | None:
        """The tissue's outline and pose, by the left view."""
        from svmdist.estimation.detection.tissue import detect_tissue

        return detect_tissue(self.left.masks, self._profile, self.observation.camera)

    @detected
    def stereo_pair(self) -> RectifiedPair | Failure:
        """The geometry of both views, where they are a rectified pair."""
        from svmdist.vision.rectified import rectified_pair

        right = self.observation.right
        return Failure("no right view") if right is None else rectified_pair(self.observation.camera, right)

    @detected
    def stereo_surface(self) -> StereoSurface | None:
        """The tissue's surface by both views; None where it is not seen, or they do not agree."""
        from svmdist.estimation.detection.stereo_surface import detect_stereo_surface

        tissue, pair = self.tissue, self.stereo_pair
        if tissue is None or self.right is None or isinstance(pair, Failure):
            return None
        return detect_stereo_surface(
            self.left.grey,
            self.right.grey,
            pair,
            tissue.region.hull,
            (self.left.masks.tissue, self.right.masks.tissue),
            self._profile.stereo_in_range,
        )

    @detected
    def tags(self) -> dict[int, Array]:
        """Corners, shape (4, 2) in px, of every tag of the fiducial's family in the left view, by number."""
        return self._tags(self.left)

    @detected
    def right_tags(self) -> dict[int, Array]:
        """The same in the right view."""
        return {} if self.right is None else self._tags(self.right)

    def _tags(self, view: FrameContext) -> dict[int, Array]:
        from svmdist.vision.tag.detection import find_tags

        fiducial = self._profile.fiducial
        return {} if fiducial is None else find_tags(view.grey, fiducial.family, self._profile.settings.tag)
