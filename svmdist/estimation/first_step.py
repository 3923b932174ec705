"""The first step of every method: what is known of a frame before the tool is measured."""

from __future__ import annotations

from svmdist.estimation.frame import Frame
from svmdist.estimation.tissue.pose import TissuePose
from svmdist.estimation.tissue.tracking import TissueTracker
from svmdist.results import FrameResult, as_pixel
from svmdist.samples import Status


def with_tissue(frame: Frame) -> FrameResult:
    """A result of status `ok` with the tissue that this frame shows, or of `no_tissue`."""
    result, tissue = FrameResult(frame.stamp_ns, Status.NO_TISSUE), frame.scene.tissue
    if tissue is None:
        return result
    result = result.with_image(
        tissue_px=as_pixel(tissue.outline.centroid_px), tissue_area_px=tissue.region.area_px
    )
    if tissue.pose is None:
        return result.rejected(Status.NO_TISSUE, "the tissue's ray does not meet the profile's plane")
    return result.rejected(Status.OK)


def tracked_tissue(frame: Frame, tracker: TissueTracker) -> TissuePose | None:
    """The tissue after this frame, which may hide it."""
    tissue = frame.scene.tissue
    return tracker.add(None if tissue is None else tissue.pose)
