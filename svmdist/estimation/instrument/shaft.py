"""The shaft and the distal marker: what one image shows of them, and what is known of an instrument before looking.

Seen are tangent planes along both edges, the end and the marker's size; known are the instrument's sizes, and where its
shaft and wrist are by the joints.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from svmdist import kinematics as dh
from svmdist.camera import Camera
from svmdist.errors import ProfileError
from svmdist.estimation.instrument.model import SHAFT_END_PER_RADIUS
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile.robot import Instrument
from svmdist.profile.settings import DistalMarkerSettings
from svmdist.results import Failure
from svmdist.samples import Image
from svmdist.transforms import Array, cross, inverse, make_transform
from svmdist.vision.instruments.find_instruments import SeenInstrument
from svmdist.vision.instruments.outline_search import LEAST_LENGTH, LONGEST_WRIST
from svmdist.vision.lines import CylinderAxis, TangentPlane, axis_of_cylinder, fit_line, line_between
from svmdist.vision.regions import Disc, Region, fit_disc
from svmdist.vision.silhouette import Rim, Silhouette, WristPoint, WristShape

LINE_INLIER_PX = 0.5  # of an edge's point off its line: ten times the least deviation of a point
LINE_INLIER_PER_WIDTH = 0.012  # for a silhouette's edges: near ones are less sharp, and lenses bend them
MIN_LINE_POINTS = 5  # of an edge: fewer lie on a line by chance
SHADING_STD_PX = 0.15  # where nothing is known of the light: a limb fades or shines
MAX_LOG_RATIO = 0.25  # between radii by circle and area: further apart they are different things
BORDER_POINTS = 8.0  # of the border that err independently: it is cut by fork and jaws, each over an eighth
STD_PER_DOUBT = 1.5  # of the radius: of 808 simulated ones 2% are off by more than two deviations
WHOLE_ASPECT = 0.9  # of a whole marker's width over its length: fork and jaws cut a tenth
CENTROID_STD = 0.045  # by how much hidden parts move the region's centroid, over the radius
NEAREST_M, FARTHEST_M = 0.02, 0.5  # of a shaft's end: nearer it fills the view, farther it has no light

FORESHORTENED = 0.15  # of a length along the shaft over its width: shafts are tilted by 30° or so
OUTLINE_END_STD_RADII = 0.25  # of the cylinder's end in an outline: clevises differ, a bent wrist hides them
UNKNOWN_END = 0.5  # deviation of the distance from hinge to the shaft's end where the profile has none, over itself
MOST_NEAR = 0.1  # probability of an end so near to the border that the sides would be a wrist's
JAWS_TURN = 0.15  # of an outline's tip over the length of closed, straight jaws: they open and turn
CLEVIS_PER_RADIUS = 0.9
"""The clevis of a da Vinci instrument of 8 mm reaches so far beyond the wrist's pitch axis, over the shaft's radius."""


@dataclass(frozen=True, slots=True)
class DistalMarker:
    """The marker: the middle of its circle, or of its region, (2,), and its radius, with standard deviations, in px."""

    centre_px: Array
    std_px: float
    radius_px: float | None  # of the whole sphere; None where the image's border or something else cuts it
    radius_std_px: float
    disc: Disc | None = None  # the circle along its border that the radius comes from
    area_px: float = 0.0  # of what is visible
    hidden_px: float = 0.0  # by how much of the radius' deviation something hides it


def detect_distal_marker(
    image_hsv: Image, mask: Image, region: Region, settings: DistalMarkerSettings
) -> DistalMarker | None:
    """The region of the mask (h, w) as a disc, sized where the colour has half its strength; None of bare steel."""
    x, y, width, height = cv2.boundingRect(mask)
    window = np.s_[y : y + height, x : x + width]
    if np.median(image_hsv[window][..., 1][mask[window] > 0]) < settings.min_saturation:
        return None
    # At the image's border there is no circle to fit, nor where the colour's border is another one.
    corners, radius_px = region.hull.reshape(-1, 2), float(np.sqrt(region.area_px / np.pi))
    is_whole = bool(((corners > 1) & (corners < [mask.shape[1] - 2, mask.shape[0] - 2])).all())
    disc = fit_disc(image_hsv, mask, region.centroid_px, radius_px) if is_whole else None
    if disc is None or abs(np.log(disc.radius_px / radius_px)) >= MAX_LOG_RATIO:
        return DistalMarker(region.centroid_px, 0.5 * radius_px, None, 0.0, None, region.area_px)
    # Of a disc whose part is hidden the circle is too small, as an ellipse's area is to the circle about it.
    moments = cv2.moments(region.hull.astype(np.float32))
    spread = [[moments["mu20"], moments["mu11"]], [moments["mu11"], moments["mu02"]]]
    narrow, long = np.sqrt(np.maximum(np.linalg.eigvalsh(spread), 1.0))
    hidden = max(0.0, float(np.sqrt(WHOLE_ASPECT * long / narrow)) - 1.0)
    whole_px = (1.0 + hidden) * disc.radius_px / settings.visible_radius
    own_px = np.hypot(disc.scatter_px / np.sqrt(BORDER_POINTS), STD_PER_DOUBT * disc.doubt_px)
    hidden_px = hidden * disc.radius_px
    radius_std_px = float(np.linalg.norm([settings.radius_std * whole_px, own_px, hidden_px]))
    std_px = CENTROID_STD * whole_px
    return DistalMarker(disc.centre_px, std_px, whole_px, radius_std_px, disc, region.area_px, hidden_px)


@dataclass(frozen=True, slots=True)
class ShaftDetection:
    """Contours (none, one or two), the planes that touch the shaft there, and the rim, each as far as it is visible."""

    contours: tuple[TangentPlane, ...] = ()
    axis: CylinderAxis | None = None  # by both sides, where they are visible
    rim: Rim | None = None
    towards_tip: Array | None = None  # direction of the shaft's middle line in the image, (2,); None if unknown
    middle_px: Array | None = None
    wrist: WristPoint | None = None  # where the tool's origin is in the outline of a whole instrument
    width_std: float = 0.0  # deviation over the width of what both contours get wrong alike
    wrist_std: float = 0.0  # the same of what may be no shaft, where nothing else shows its depth


NO_SHAFT = ShaftDetection()


def detect_silhouette(
    silhouette: Silhouette, camera: Camera, radius_m: float, beside: tuple[float, float] = (0.0, 0.0)
) -> ShaftDetection:
    """Contours, end and wrist of a shaft by its silhouette; `NO_SHAFT` where one of its radius cannot stand.

    Its sides may be those of something wider on it, by `beside` of its width: of a sharp side, of one without an edge.
    """
    towards_tip, middle_px = silhouette.towards_tip, silhouette.middle_px
    unit, inside = 1.0 / float(camera.K[0, 0]), camera.rays(middle_px)[0, :2]
    found: dict[int, TangentPlane] = {}
    for edge in silhouette.edges:
        inlier_px = max(LINE_INLIER_PX, LINE_INLIER_PER_WIDTH * silhouette.width_px, edge.within_px)
        ends = camera.rays(np.stack([edge.start_px, edge.end_px]))[:, :2]
        if edge.covariance is None:
            points = camera.rays(edge.points_px)[:, :2]
            plane = fit_line(points, unit, inside, MIN_LINE_POINTS, inlier_px, SHADING_STD_PX)
        else:
            plane = line_between(ends, edge.covariance * unit**2, inside)
        if plane is not None:
            off = 0.5 * beside[edge.covariance is not None] * silhouette.width_px * unit
            wider = line_between(ends, np.full((2, 2), off**2), inside)
            outward = 0.5 * (edge.start_px + edge.end_px) - middle_px
            side = 1 if towards_tip[0] * outward[1] - towards_tip[1] * outward[0] > 0 else -1
            found.setdefault(side, replace(plane, covariance=plane.covariance + wider.covariance, side=side))
    contours, axis = tuple(found.values()), None
    if len(contours) == 2:
        axis = axis_of_cylinder(contours, radius_m)
        place_px = middle_px if silhouette.rim is None else silhouette.rim.pixel
        if axis is None or not NEAREST_M < axis.depth_m(camera.rays(place_px)[0]) < FARTHEST_M:
            return NO_SHAFT
    known = towards_tip if silhouette.knows_tip else None
    stds = silhouette.width_std, silhouette.wrist_std
    return ShaftDetection(contours, axis, silhouette.rim, known, middle_px, silhouette.wrist, *stds)


@dataclass(frozen=True, slots=True)
class ShaftSizes:
    """The sizes of a shaft by the profile, or as suggested; `reach_m` is from hinge to tool."""

    instrument: Instrument
    reach_m: float

    @property
    def radius_m(self) -> float:
        """The shaft's radius."""
        return self.instrument.shaft_radius_m

    @property
    def end_m(self) -> float:
        """From the hinge back to where the dark shaft ends."""
        return self.instrument.shaft_end_m or SHAFT_END_PER_RADIUS * self.instrument.wrist_radius_m

    @property
    def tip_m(self) -> float:
        """From the hinge on to the tips of straight jaws."""
        return self.reach_m + self.instrument.jaw_length_m

    @property
    def jaw_tip_std_m(self) -> float:
        """How far the tip of an outline may be from that of straight jaws of the profile's length."""
        return float(np.hypot(self.instrument.body_std_m, JAWS_TURN * self.instrument.jaw_length_m))

    def end_std_m(self, default_std_m: float) -> float:
        """How wrong that may be; `default_std_m` is of a length that the profile gives without a deviation."""
        if (std_m := self.instrument.shaft_end_std_m) is not None:
            return std_m
        return UNKNOWN_END * self.end_m if self.instrument.shaft_end_m is None else default_std_m

    @property
    def outline_end_m(self) -> float:
        """From the hinge on to where the outline stops being the shaft's; unknown, midway between the extremes."""
        given = self.instrument.outline_end_m
        return 0.5 * (CLEVIS_PER_RADIUS * self.radius_m - self.end_m) if given is None else given

    @property
    def outline_end_std_m(self) -> float:
        """How wrong that may be: a clevis is as wide as the shaft up to its end, or narrower from the shaft on."""
        if (std_m := self.instrument.outline_end_std_m) is not None:
            return std_m
        if self.instrument.outline_end_m is not None:
            return OUTLINE_END_STD_RADII * self.radius_m
        return 0.5 * (CLEVIS_PER_RADIUS * self.radius_m + self.end_m)

    def with_likelier_end(self, seen: SeenInstrument, default_std_m: float) -> SeenInstrument:
        """The instrument with the other one of its two ends, where these are not as far apart as shaft and wrist are.

        What ends on a shaft without being its end is anywhere in the stretch that was searched. The outline is as
        likely to end where the wrist narrows as at the jaws' joint, or at the tips of straight jaws; where another
        instrument touches it, as likely anywhere as at one of these, since that one may hide the rest. Where the shaft
        and what is as wide beyond it may end next to the border already, the sides are a wrist's: no shaft is shown.
        """
        collar_widths = (self.end_m + self.outline_end_m) / (2.0 * self.radius_m)
        if seen.near_share > MOST_NEAR and seen.near_widths + collar_widths < LEAST_LENGTH:
            return replace(seen, shows_shaft=False)
        if not 0.0 < seen.other_share < 1.0:
            return seen
        apart_m = abs(seen.other_px) / seen.width_px * 2.0 * self.radius_m
        mean_m = self.end_m + np.array([self.outline_end_m, self.reach_m, self.tip_m])
        near_std_m = np.hypot(np.hypot(self.end_std_m(default_std_m), self.outline_end_std_m), FORESHORTENED * apart_m)
        std_m = np.array([near_std_m, near_std_m, np.linalg.norm([near_std_m, self.jaw_tip_std_m])])
        p = np.exp(-0.5 * ((apart_m - mean_m) / std_m) ** 2) / (np.sqrt(2.0 * np.pi) * std_m)
        density = LONGEST_WRIST * 2.0 * self.radius_m * float(p.mean())
        if seen.touches_another:
            density = 0.5 * (density + 1.0)
        own, other = (density, 1.0) if seen.ends_dark else (1.0, density)
        own, other = own * (1.0 - seen.other_share), other * seen.other_share
        share = other / (own + other)
        if share <= 0.5:
            return replace(seen, other_share=share)
        end_px = seen.end_px + seen.other_px * seen.axis
        is_dark, other_px = not seen.ends_dark, -seen.other_px
        return replace(seen, end_px=end_px, ends_dark=is_dark, other_px=other_px, other_share=1.0 - share)

    def rim_ahead(self, shaft: ShaftDetection, default_std_m: float) -> tuple[float, float]:
        """How far beyond the hinge a shaft's rim is, and the deviation of that by all that it may be.

        Wrist and jaws in line with a shaft look like more of it, so that an outline beyond which nothing is seen may be
        that of anything up to their tips. Where another end is possible, the likelier one stays where it is, and is
        less sure: between both there is none.
        """
        rim = shaft.rim
        assert rim is not None  # who asks has one
        dark = -self.end_m, self.end_std_m(default_std_m)
        outline = self.outline_end_m, self.outline_end_std_m
        own, other = (outline, dark) if rim.is_outline else (dark, outline)
        beyond_m = self.tip_m - own[0]
        is_tip = 1.0 - rim.narrows if rim.is_outline and shaft.wrist is None else 0.0
        share = np.array([(1.0 - rim.other_share) * (1.0 - is_tip), rim.other_share, 0.0])
        share[2] = 1.0 - share.sum()
        ahead_m = np.array([own[0], other[0] - rim.other_radii * self.radius_m, own[0] + 0.5 * beyond_m])
        variance_m2 = np.square([own[1], other[1], np.hypot(own[1], beyond_m / np.sqrt(12.0))])
        mean_m = own[0] + 0.5 * is_tip * beyond_m
        return mean_m, float(np.sqrt(share @ (variance_m2 + (ahead_m - mean_m) ** 2)))


@dataclass(frozen=True, slots=True)
class ShaftModel(ShaftSizes):
    """The instrument behind its shaft's frame S: origin on the wrist's hinge, z along the shaft to the tip."""

    q: Array  # straight where no joints are known
    T_base_shaft: Array
    T_shaft_tool: Array
    R_camera_shaft: Array | None  # by nominal kinematics; None without the robot's base
    axis: dh.ShaftAxis
    hinge_m: Array  # the wrist's, (3,) in the frame of the axis' link, which slides along the shaft

    @classmethod
    def of(cls, robot: RobotState | Failure, chain: dh.DHChain, instrument: Instrument) -> ShaftModel:
        """By the joints and the base, as far as they are known; ProfileError for a chain without a shaft."""
        turns, axis = dh.rows_behind_insertion(chain), dh.shaft_of(chain)
        if len(turns) < 2 or axis is None:
            raise ProfileError("the method shaft needs a chain that slides along its shaft, turns it, and has a wrist")
        q = robot.q if isinstance(robot, RobotState) else np.zeros(len(chain.joint_names))
        roll, frames = turns[0], dh.frame_transforms(chain, q)
        z, on_axis_m = dh.joint_axis(chain, frames, roll)
        _, on_hinge_m = dh.joint_axis(chain, frames, roll + 1)
        x = frames[roll, :3, 0] - z * float(z @ frames[roll, :3, 0])
        x /= np.linalg.norm(x)
        origin_m = on_axis_m + z * float(z @ (on_hinge_m - on_axis_m))
        T_base_shaft = make_transform(np.stack([x, cross(z, x), z], -1), origin_m)
        T_shaft_tool = inverse(T_base_shaft) @ frames[-1] @ chain.T_last_tool
        R_camera_shaft = None
        if isinstance(robot, RobotState) and robot.T_camera_base is not None:
            R_camera_shaft = np.asarray((robot.T_camera_base @ T_base_shaft)[:3, :3])
        reach_m = float(np.linalg.norm(T_shaft_tool[:3, 3]))
        hinge_m = np.asarray((inverse(frames[dh.row_index(chain, axis.link)]) @ T_base_shaft)[:3, 3])
        return cls(instrument, reach_m, q, T_base_shaft, T_shaft_tool, R_camera_shaft, axis, hinge_m)

    def wrist_shape(self, *, ends_dark: bool) -> WristShape:
        """What is visible beyond the end of the outline, or of the dark part, with the wrist straight."""
        ahead_m = max(self.reach_m - (-self.end_m if ends_dark else self.outline_end_m), 0.0)
        length_m = ahead_m + self.instrument.jaw_length_m
        return WristShape(ahead_m / length_m, length_m / (2.0 * self.radius_m))
