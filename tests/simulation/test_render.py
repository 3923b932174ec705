"""What is drawn lies where the camera model says, whatever was drawn before, and looks as geometry and optics say."""

import cv2
import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.perturbations.apply import perturbed_image
from svmdist.profile.segmentation import ColourRegion
from svmdist.samples import Image
from svmdist.simulation import effects
from svmdist.simulation.meshes import sphere
from svmdist.simulation.organ import Organ
from svmdist.simulation.scene import Options, make_scene
from svmdist.transforms import Array, inverse, make_transform, transform_points
from svmdist.vision.colour import colour_mask, to_hsv
from svmdist.vision.degradations import dimmed, light_left, subsampled
from tests.simulation.conftest import chosen, perturbed, posed, withdrawn

pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
from svmdist.simulation.plan import SceneState
from svmdist.simulation.render import FAR_M, Renderer, metric_depth_m

CAMERA = Camera.from_horizontal_fov(320, 240, np.pi / 3)
SHAPE = (240, 320)
FLOOR_M = 0.112
T_CAMERA_TISSUE = make_transform(np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, FLOOR_M])


def drawn(
    renderer: Renderer,
    q: Array,
    turn: int = 0,
    camera: int = 0,
    T_world_retractor: Array | None = None,
    offset_m: float = 0.0,
    organ: Organ | None = None,
) -> Image:
    renderer.pose(SceneState((q,), T_world_retractor, offset_m), organ)
    return renderer.draw(camera, turn)


def seen_px(image: Image, region: ColourRegion) -> Array:
    """Columns and rows, shape (n, 2), of what has the colours of a region."""
    return np.column_stack(np.nonzero(colour_mask(to_hsv(image), region)))[:, ::-1]


def contour_m(centre_m: Array, radius_m: float) -> Array:
    """Where rays from the camera touch a sphere, shape (720, 3), in the camera's frame."""
    squared = centre_m @ centre_m
    normal = centre_m / np.sqrt(squared)
    u = np.cross(normal, [1.0, 0.0, 0.0])
    u /= np.linalg.norm(u)
    angle = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)[:, None]
    circle = np.cos(angle) * u + np.sin(angle) * np.cross(normal, u)
    shrink = 1.0 - radius_m**2 / squared
    return np.asarray(centre_m * shrink + radius_m * np.sqrt(shrink) * circle)


@pytest.mark.parametrize("camera", [0, 1])
def test_balls_are_seen_where_opencv_projects_them(profile, camera):
    """All over the image, the corners among them, through the lens: within 0.2 px of cv2.projectPoints."""
    scene = make_scene(profile, 1, perturbed("lens=1"))
    T_world_eye = scene.T_world_camera @ (np.eye(4), scene.T_camera_right)[camera]
    radius_m, K, errors = 0.0014, scene.camera.K, []
    with Renderer([scene]) as renderer:
        ball = renderer._add_mesh(sphere(radius_m), (0.0, 1.0, 0.0, 1.0))
        for x_px, y_px in ((20, 20), (600, 25), (30, 440), (320, 240), (150, 300), (320, 30)):
            centre_m = 0.09 * np.array([(x_px - K[0, 2]) / K[0, 0], (y_px - K[1, 2]) / K[1, 1], 1.0])
            at_m = transform_points(T_world_eye, centre_m[None])[0]
            renderer.place(ball, make_transform(np.eye(3), at_m))
            renderer._backgrounds.clear()
            image = drawn(renderer, withdrawn(scene), camera=camera)
            blue, green, red = np.moveaxis(image.astype(int), -1, 0)
            rows, columns = np.nonzero((green > 70) & (green > 1.5 * np.maximum(blue, red)))
            outline_m, D = contour_m(centre_m, radius_m), scene.camera.D
            outline = cv2.projectPoints(outline_m, np.zeros(3), np.zeros(3), K, D)[0]
            moments = cv2.moments(outline[:, 0].astype(np.float32))
            expected = np.array([moments["m10"], moments["m01"]]) / moments["m00"]
            errors.append(np.array([columns.mean(), rows.mean()]) - expected)
    assert np.abs(errors).max() < 0.2


def test_colours_separate_and_bodies_are_where_they_stand(scene, profile):
    """Tissue and distal marker are found whole, by colour alone, and the right camera sees the baseline's disparity."""
    tissue, marker = profile.segmentation.tissue, profile.segmentation.instrument
    with Renderer([scene]) as renderer:
        for p_world_m in ([0.04, 0.0, 0.0245], [0.03, -0.03, 0.02], [0.012, 0.0, 0.0245]):
            image = drawn(renderer, posed(scene, p_world_m))
            found, right = (seen_px(each, marker) for each in (image, renderer.draw(1, 1)))
            assert 280 < len(found) < 520
            p_camera_m = transform_points(inverse(scene.T_world_camera), np.array([p_world_m]))
            np.testing.assert_allclose(found.mean(axis=0), scene.camera.project(p_camera_m)[0], atol=1.2)
            disparity_px = [scene.camera.K[0, 0] * 0.005 / p_camera_m[0, 2], 0.0]
            np.testing.assert_allclose(found.mean(axis=0) - right.mean(axis=0), disparity_px, atol=0.3)
            assert 38000 < len(seen_px(image, tissue)) < 53000
        found = seen_px(drawn(renderer, withdrawn(scene)), tissue)
    expected_px = scene.camera.project(scene.T_camera_tissue()[:3, 3][None])[0]
    np.testing.assert_allclose(found.mean(axis=0), expected_px, atol=0.5)


def test_the_tag_is_decoded_where_the_profile_says(profile):
    """All over its field of view: OpenCV finds it, and every corner within 1 px of its projection."""
    scene, fiducial = make_scene(profile, 1, Options(tag=True)), profile.fiducial
    corners_m = 0.5 * fiducial.size_m * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.cornerRefinementWinSize = 3
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    detector, errors_px = cv2.aruco.ArucoDetector(dictionary, parameters), []
    with Renderer([scene]) as renderer:
        for x_m, y_m in ((-0.03, -0.022), (-0.01, 0.022), (0.01, 0.0), (-0.01, -0.022), (0.01, 0.022)):
            q = posed(scene, [x_m, y_m, 0.0245])
            corners, ids, _ = detector.detectMarkers(drawn(renderer, q))
            assert ids.ravel().tolist() == [fiducial.id]
            T_camera_tag = inverse(scene.T_world_camera) @ scene.part_poses(q)[-1]
            expected_px = scene.camera.project(transform_points(T_camera_tag, corners_m))
            errors_px.append(corners[0][0] - expected_px)
    assert np.abs(errors_px).max() < 1.0
    assert np.abs(np.mean(errors_px, axis=(0, 1))).max() < 0.15


def test_images_show_raised_and_dented_tissue_and_then_rest_again(profile):
    """The outline's area grows with the square of 1 / depth; a dent changes what is near it alone."""
    scene = make_scene(profile, 1, perturbed("breathing=5,dent=2"))
    mesh = scene.organ.mesh
    down_m = 0.003 * np.exp(-np.sum((mesh.vertices_m[:, :2] - [0.004, 0.002]) ** 2, axis=1) / 0.003**2)
    vertices_m = mesh.vertices_m - down_m[:, None] * [0.0, 0.0, 1.0]
    dented = Organ(type(mesh)(vertices_m, mesh.faces, mesh.normals, mesh.uv), scene.organ.outline_m, 0.008)
    away = withdrawn(scene)
    with Renderer([scene]) as renderer:
        rest, up = (drawn(renderer, away, offset_m=offset_m) for offset_m in (0.0, 0.005))
        pressed, again = drawn(renderer, away, organ=dented), drawn(renderer, away)
    np.testing.assert_array_equal(rest, again)
    areas = [len(seen_px(image, profile.segmentation.tissue)) for image in (rest, up)]
    assert areas[1] / areas[0] == pytest.approx((0.112 / 0.107) ** 2, rel=0.01)
    changed = np.column_stack(np.nonzero((rest != pressed).any(axis=2)))[:, ::-1]
    assert len(changed) > 500
    moved_px = scene.camera.project(transform_points(scene.T_camera_tissue(), mesh.vertices_m[down_m > 1e-6]))
    assert (changed > moved_px.min(axis=0) - 8.0).all()
    assert (changed < moved_px.max(axis=0) + 8.0).all()


@pytest.mark.parametrize("strength", [0.3, 1.0, 2.5])
def test_the_lens_undoes_opencvs_distortion(scene, strength):
    """Where a pixel looks in the pinhole image, distorted again, is the pixel: to 0.001 px."""
    camera, D = scene.camera, strength * effects.DISTORTION
    lens = effects.Lens.of(camera, D)
    at_px = lens.at_px[::60, ::60].reshape(-1, 2).astype(np.float64)
    rays = (at_px - lens.wide.K[:2, 2]) / np.diag(lens.wide.K)[:2]
    rays = np.column_stack([rays, np.ones(len(rays))])
    back, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.K, D)
    rows, columns = np.mgrid[: camera.height_px : 60, : camera.width_px : 60]
    np.testing.assert_allclose(back[:, 0], np.stack([columns, rows], -1).reshape(-1, 2), atol=1e-3)


def floor(depth_m: float = FLOOR_M) -> effects.Surfaces:
    """A floor across the camera's axis, and nothing before it."""
    depths = np.full(SHAPE, depth_m, np.float32)
    return effects.Surfaces(CAMERA, depths, depths, np.ones(SHAPE, bool), np.zeros(SHAPE, np.int64), {})


def shaded(
    text: str, surfaces: effects.Surfaces, lamp_m: Array, lamp_depth_m: Array | None = None, level: int = 100
) -> Array:
    shader = effects.Shader(chosen(text), 1)
    shader._slopes[:] = 0.0  # a film without bumps
    image = np.full((*SHAPE, 3), level, np.uint8)
    return np.asarray(shader.shaded(image, surfaces, lamp_m, lamp_depth_m, T_CAMERA_TISSUE)[..., 0], np.float64)


def test_light_falls_off_with_the_distance_squared():
    """In light, not in levels: those are light to the power of 1 / 2.2. Depth buffers are metric."""
    for depth_m in (0.06, 0.112):
        seen = shaded("light=1", floor(depth_m), effects.LAMP_M)
        for row, column in ((120, 160), (10, 10), (200, 300)):
            ray = [*((np.array([column, row]) - CAMERA.K[:2, 2]) / np.diag(CAMERA.K)[:2]), 1.0]
            light = (effects.FULL_LIGHT_M / np.linalg.norm(depth_m * np.array(ray) - effects.LAMP_M)) ** 2
            assert seen[row, column] == pytest.approx(100.0 * light ** (1 / effects.GAMMA), abs=0.6)
    buffer = np.array([0.0, 0.25, 1.0], np.float32)
    np.testing.assert_allclose(1 / metric_depth_m(buffer), 100.0 + buffer * (1 / FAR_M - 100.0), rtol=1e-6)


def test_a_shadow_lies_where_the_lamp_throws_it():
    """A square at 80 mm from the lamp: its shadow's middle is 1.4 times as far aside on the floor."""
    half_m, at_m = 0.008, np.array([0.01, 0.004, 0.080])
    column, row = np.meshgrid(np.arange(SHAPE[1]), np.arange(SHAPE[0]))
    x_m = (column - CAMERA.K[0, 2]) / CAMERA.K[0, 0] * at_m[2]
    y_m = (row - CAMERA.K[1, 2]) / CAMERA.K[1, 1] * at_m[2]
    is_there = (abs(x_m - at_m[0]) < half_m) & (abs(y_m - at_m[1]) < half_m)
    lamp_depth_m = np.where(is_there, at_m[2], FAR_M).astype(np.float32)
    hidden = effects.shadow(CAMERA, floor().points_m(floor().depth_m), effects.LAMP_M, lamp_depth_m)
    rows, columns = np.nonzero(hidden > 0.5)
    expected_m = effects.LAMP_M + at_m / at_m[2] * FLOOR_M
    np.testing.assert_allclose([columns.mean(), rows.mean()], CAMERA.project(expected_m[None])[0], atol=0.6)
    dark = shaded("shadow=1", floor(), effects.LAMP_M, lamp_depth_m)
    assert dark[hidden > 0.999].max() == pytest.approx(100.0 * 0.25 ** (1 / effects.GAMMA), abs=1.0)
    assert (dark[hidden == 0.0] == 100.0).all()


@pytest.mark.parametrize("eye_m", [0.0, 0.005])
def test_a_highlight_is_where_a_mirror_shows_the_lamp(eye_m):
    """On a plane across the axis, half way between camera and lamp; it moves with the camera."""
    lamp_m = effects.LAMP_M - [eye_m, 0.0, 0.0]
    image = shaded("wet=1", floor(), lamp_m, level=0)
    rows, columns = np.nonzero(image > 0.5 * image.max())
    mirror_m = np.array([*0.5 * lamp_m[:2], FLOOR_M])
    np.testing.assert_allclose([columns.mean(), rows.mean()], CAMERA.project(mirror_m[None])[0], atol=0.7)


def test_instruments_look_as_perturbed(profile):
    """A bare tip shows no colour; a ring shows it 3 mm behind the origin; blood stays on the tool; shafts are blue."""
    marker = ColourRegion(hue=(80, 105), saturation=(52, 255), min_area_px=1)
    images = {}
    for text in ("", "tip=1", "ring=3", "blood=0.25", "shaft_blue=1"):
        scene = make_scene(profile, 1, perturbed(text))
        q = posed(scene, [0.012, 0.0, 0.0245])
        with Renderer([scene]) as renderer:
            images[text] = drawn(renderer, q)
            picture = renderer._picture(scene.T_world_camera, 0, still=False)
    coloured = {text: seen_px(image, marker) for text, image in images.items()}
    assert len(coloured[""]) > 300
    assert len(coloured["tip=1"]) == 0
    poses = dict(zip([part.name for part in scene.parts], scene.part_poses(q), strict=True))
    T_camera_wrist = inverse(scene.T_world_camera) @ poses["bridge"]
    ring_px = scene.camera.project(transform_points(T_camera_wrist, [[-0.003, 0.0, 0.0]]))[0]
    np.testing.assert_allclose(coloured["ring=3"].mean(axis=0), ring_px, atol=1.5)
    changed = np.abs(images[""].astype(int) - images["blood=0.25"]).max(axis=2) > 25
    on_tool = (picture.bodies >= 0).view(np.uint8)
    assert 0.12 < changed[on_tool > 0].mean() < 0.4
    assert not changed[cv2.dilate(on_tool, np.ones((5, 5))) == 0].any()
    T_camera_roll = inverse(scene.T_world_camera) @ poses["shaft"]
    on_axis_m = transform_points(T_camera_roll, [[0.0, 0.016, 0.0]])
    column, row = np.rint(scene.camera.project(on_axis_m)[0]).astype(int)
    hue, saturation, value = cv2.cvtColor(images["shaft_blue=1"], cv2.COLOR_BGR2HSV)[row, column]
    assert (100 <= hue <= 125, saturation > 100, value > 75) == (True, True, True)


def test_the_border_is_round_and_colour_is_kept_for_two_by_two_pixels():
    plain = np.full((480, 640, 3), 200, np.uint8)
    rows, columns = np.mgrid[:480, :640]
    radius_px = np.hypot(columns - 319.5, rows - 239.5)
    image = dimmed(plain, 1.0, 0.0)
    assert (image[radius_px > 322.0] == 0).all()
    assert (image[radius_px < 318.0] == 200).all()
    left = light_left(0.0, 0.3, 640, 480)
    assert (left.min(), left.max()) == pytest.approx((0.7, 1.0), abs=1e-4)
    y_cr_cb = np.full((480, 640, 3), 120, np.uint8)
    y_cr_cb[:, ::2, 1:], y_cr_cb[:, 1::2, 1:] = (90, 160), (170, 100)
    striped = np.asarray(cv2.cvtColor(y_cr_cb, cv2.COLOR_YCrCb2BGR), np.uint8)
    seen = cv2.cvtColor(subsampled(striped, 1.0), cv2.COLOR_BGR2YCrCb).astype(int)
    assert np.abs(seen[..., 0] - 120).max() <= 2
    assert np.ptp(seen[..., 1]) <= 4
    assert perturbed_image(plain, chosen("focal=1")) is plain
