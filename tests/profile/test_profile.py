"""Profiles: what ships loads, and every mistake in a file becomes one line with file, key and nearest key."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from svmdist.errors import ProfileError, UsageError
from svmdist.kinematics import chain_of
from svmdist.profile import DEFAULT_PROFILE, Profile, load_profile, profile_path, shipped_profiles
from svmdist.profile.robot import TAGS, Joint
from tests.shipped import PSM13

NO_ANGLES = "|-|90|90deg|pi/0|pi*2|pi/2/2|pi/pi|2pi|--pi|tau|nan*pi|pi/nan|inf*pi|pi/|*pi"
MINIMAL = """
name = "mine"
[segmentation.tissue]
hue = [170, 8]
min_area_px = 50
[segmentation.instrument]
hue = [80, 105]
min_area_px = 100
"""


def load_text(folder: Path, text: str) -> Profile:
    path = folder / "mine.toml"
    path.write_text(text, "utf-8")
    return load_profile(path)


def test_shipped_profiles_load_and_the_default_is_the_papers():
    """By name and by path; gates (50, 100, 100), ratio 0.75, 3 px and a posture inside the limits of 13 joints."""
    for name in shipped_profiles():
        profile = load_profile(name)
        assert profile.name == name
        assert load_profile(profile_path(name)) == profile
    assert DEFAULT_PROFILE in shipped_profiles()
    profile = load_profile()
    gates = (profile.segmentation.tissue, profile.segmentation.instrument, profile.marker.outline)
    assert [region.min_area_px for region in gates] == [50, 100, 100]
    assert (profile.features.ratio, profile.features.reprojection_px) == (0.75, 3.0)
    joints, posture = profile.robot.joints, profile.simulation.posture
    assert len(joints) == 13
    assert list(posture) == [joint.name for joint in joints]
    assert all(joint.lower <= posture[joint.name] <= joint.upper for joint in joints)


def test_the_tags_are_those_of_opencv():
    """OpenCV knows as many tags of each family as a profile may name."""
    for family, (count, _) in TAGS.items():
        dictionary = getattr(cv2.aruco, f"DICT_APRILTAG_{family}")
        assert len(cv2.aruco.getPredefinedDictionary(dictionary).bytesList) == count


def test_a_profile_needs_only_colours(tmp_path):
    """Without robot, simulation and topics a profile loads: a log may have no kinematics to compare with.

    The marker is pure green where nothing else is said.
    """
    profile = load_text(tmp_path, MINIMAL)
    assert profile.marker == load_profile().marker
    assert (profile.robot, profile.simulation, profile.instrument, profile.calibration) == (None,) * 4
    assert profile.topics.image is None
    assert profile.features.ratio == 0.75


def test_each_instrument_sees_the_profile_its_own_way():
    """Topics, frames, tag and place are the other instrument's; all else is shared, and the first view is itself."""
    profile = load_profile()
    first, second = (profile.for_instrument(name) for name in profile.instrument_names)
    assert profile.instrument_names == ("PSM1", "PSM2")
    assert first == profile.model_copy(update={"other_instruments": ()})
    assert (second.topics.joints, second.topics.image) == ("/PSM2/measured_js", profile.topics.image)
    assert (second.frames.base, second.frames.tissue) == ("PSM2_base", profile.frames.tissue)
    assert second.fiducial == first.fiducial.model_copy(update={"id": 1})
    assert second.robot == first.robot
    with pytest.raises(UsageError, match=r"has no instrument PSM3: did you mean PSM[12]\?.*PSM1, PSM2"):
        profile.for_instrument("PSM3")


NO_ROTATION = "[robot]\ntool_rotation = [[1, 0, 0], [0, 1, 0], [0, 0, -1]]"
MISTAKES = [
    ("[features]", "[feature]", r"unknown key feature: did you mean features\?"),
    ("ratio = 0.75", "ratoi = 0.75", r"unknown key features\.ratoi: did you mean ratio\?"),
    ("a_m = 0.09,", "a = 0.09,", r"unknown key robot\.joints\.0\.a: "),
    ("ratio = 0.75", "ratio = 1.5", r"features\.ratio: .*less than 1 \(found 1\.5\)"),
    ("hue = [170, 8]", "hue = [170, 200]", r"tissue\.hue\.1: .*less than or equal to 179 \(found 200\)"),
    ("saturation = [80, 255]", "saturation = [255, 80]", r"tissue: saturation = \[255, 80\] is empty"),
    ("size_px = 96", "size_px = nan", r"marker\.size_px: .*finite"),
    ('convention = "standard"', 'convention = "craig"', r"convention: .*or 'modified' \(found 'craig'\)"),
    ("lower = 0.0, upper = 0.8", "lower = 0.8, upper = 0.8", r"joint setup_1: lower limit 0\.8 is not below"),
    *(
        (
            'name = "roll", type = "revolute", alpha_rad = "-pi/2", theta_rad = "-pi/2"',
            f'name = "roll", {row}',
            said,
        )
        for row, said in (
            (
                'type = "revolute", alpha_rad = -90',
                r"joint roll: expected alpha_rad .*, within 2 pi.*; found -90$",
            ),
            (
                'type = "fixed", theta_rad = 7',
                r"joint roll: .*theta_rad in rad, within 2 pi, as 'pi/2'; found 7$",
            ),
        )
    ),
    (
        "[features]",
        "[settings.stereo]\nblock_px = 8\n[features]",
        r"block_px: expected an odd number, found 8$",
    ),
    ('name = "setup_2"', 'name = "setup_1"', r"robot: joint names must differ; given twice: setup_1"),
    ('name = "psm13"', "", "missing key name"),
    ("outline_bgr = [0, 255, 0]", "", r"marker: outline_bgr is drawn and outline finds it .*both.*green$"),
    ("[0.0, 0.0, -1.0]", "[0.0, 0.0, 1.0]", r"tissue\.plane_normal: it points away from the camera"),
    ("[0.0, 0.0, -1.0]", "[0.0, 0.0, -2.0]", r"tissue\.plane_normal: it must have length 1, found 2 "),
    ("plane_distance_m = 0.112", "plane_distance_m = 112", r"distance_m: .*less than 10 \(found 112\)"),
    (
        "shaft_radius_m = 0.004",
        "shaft_radius_m = 4",
        r"instrument\.shaft_radius_m: .*less than 0\.1 \(found 4\)",
    ),
    ("id = 0", "id = 587", r"fiducial: family 36h11 has the tags 0 to 586, found 587$"),
    ("fiducial_id = 1", "fiducial_id = 999", r"family 36h11 has the tags 0 to 586, found 999$"),
    ("[robot]", NO_ROTATION, r"robot\.tool_rotation: it is not a rotation"),
    (
        'moving_joint = "yaw"',
        'moving_joint = "yow"',
        r"first_moving_joint: no joint named yow: did you mean yaw\?",
    ),
    ('link = "roll"', 'link = "rol"', r"fiducial\.link: no joint named rol: did you mean roll\?"),
    ('name = "PSM2"', 'name = "PSM1"', "needs a name of its own; given twice: PSM1"),
    ("/PSM2/measured_js", "/PSM1/measured_js", "needs a topic of its own; given twice: /PSM1/measured_js"),
    ('tool = "PSM2_tool"', 'tool = "tool"', "needs a frame of its own; given twice: tool"),
    ("fiducial_id = 1", "fiducial_id = 0", "needs a fiducial_id of its own; given twice: 0"),
    ('joints = "/PSM2/measured_js"\npose = "/PSM2/measured_cp"', "", "name joints or pose"),
    # What would overflow when it is squared, which NumPy would warn of later.
    (
        "[features]",
        "[camera_error]\nfocal_std_fraction = 1e308\n[features]",
        r"camera_error\.focal_std_fraction",
    ),
    ("distance_std_m = 1.0e-3", "distance_std_m = 1e308", r"tissue\.plane_distance_std_m"),
    ("a_m = 0.43", "a_m = 1e308", r"robot\.joints\.1\.a_m"),
    ("shaft_radius_m = 0.004", "shaft_radius_m = 1e-308", r"instrument\.shaft_radius_m"),
    ("[0.0, 0.0085, 0.0046]", "[0.0, -1e308, 0.0]", r"fiducial\.position_m"),
]


@pytest.mark.parametrize(("old", "new", "message"), MISTAKES)
def test_a_mistake_names_file_key_and_what_was_expected(tmp_path, old, new, message):
    """Each mistake gives one line that begins with the file and names the key and the value or nearest key."""
    assert old in PSM13
    with pytest.raises(ProfileError, match=message) as caught:
        load_text(tmp_path, PSM13.replace(old, new, 1))
    assert str(caught.value).startswith(f"{tmp_path / 'mine.toml'}: ")
    assert "\n" not in str(caught.value)


def test_several_mistakes_are_reported_at_once(tmp_path):
    """Two mistakes give one line with both, so that they can be mended together; of many the first five."""
    many = "".join(f"k{number} = 1\n" for number in range(9))
    with pytest.raises(ProfileError, match=r"and 4 more$"):
        load_text(tmp_path, many + PSM13)
    with pytest.raises(ProfileError) as caught:
        load_text(tmp_path, PSM13.replace("ratio = 0.75", "ratio = 2").replace("size_px = 96", "size = 96"))
    assert "features.ratio: " in str(caught.value)
    assert "unknown key marker.size: did you mean size_px?" in str(caught.value)


def test_angles_are_numbers_or_multiples_of_pi():
    """A multiple of pi is exact: 'pi/2' is the double that NumPy calls π/2; no other text is an angle."""
    angles = {"pi": np.pi, "-pi": -np.pi, "pi/2": np.pi / 2, "-pi/2": -np.pi / 2, "2*pi/3": 2 * np.pi / 3}
    for text, angle_rad in (angles | {"-0.5 * pi / 4": -np.pi / 8, 0.25: 0.25, -1: -1.0}).items():
        assert Joint(name="j", type="revolute", alpha_rad=text).alpha_rad == angle_rad
    for text in NO_ANGLES.split("|"):
        with pytest.raises(ValueError, match="alpha_rad"):
            Joint(name="j", type="revolute", alpha_rad=text)


def test_a_rotation_of_the_tool_becomes_a_transform(tmp_path):
    """tool_rotation stands in the upper left of T_last_tool, and its absence is the identity."""
    text = PSM13.replace("[robot]", "[robot]\ntool_rotation = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]", 1)
    turned = [[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    for robot, T in ((load_text(tmp_path, text).robot, turned), (load_profile().robot, np.eye(4))):
        np.testing.assert_array_equal(chain_of(robot).T_last_tool, T)


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        (
            "a.toml",
            b"schema = 1\nmethod = 2\nx = 3",
            "not a profile file: expected the keys .* found 'schema', 'method'",
        ),
        ("", None, "cannot read: Is a directory"),
        ("a.toml", b'name = "x"\nhue = [1, = 2]\n', r"a\.toml: not a TOML file: .*line 2, column 11"),
        ("a.toml", 'name = "Ger\xe4t"'.encode("latin-1"), r"a\.toml: not a TOML file: byte 11 is not UTF-8"),
        ("a.toml", b"[robot]\njoints = " + b"[" * 10_000 + b"]" * 10_000, "nested too deeply"),
        ("a.toml", b"a = " + b"{b=" * 10_000 + b"1" + b"}" * 10_000, "nested too deeply"),
        ("a.toml", b'name = "x"\n[features]\nfeature_count = ' + b"9" * 5000, "value has 5000 digits"),
        ("a.toml", b"[" + b"a." * 10_000 + b"b]\n", "unknown key a"),
    ],
)
def test_what_is_no_toml_file_says_why_and_where(tmp_path, name, data, message):
    if data is not None:
        (tmp_path / name).write_bytes(data)
    with pytest.raises(ProfileError, match=message):
        load_profile(tmp_path / name)
    with pytest.raises(ProfileError, match=r"no profile named psm31: did you mean psm13\? .*path to a \.toml"):
        load_profile("psm31")


def test_limits_are_numbers_of_bytes_or_text_with_a_unit(tmp_path):
    """A profile's [limits] override the defaults; text carries its unit, and nonsense is named."""
    profile = load_text(tmp_path, MINIMAL + '[limits]\nchunk_bytes = "512 MiB"\nimage_pixels = 5\n')
    assert (profile.limits.chunk_bytes, profile.limits.image_pixels) == (512 << 20, 5)
    assert profile.limits.record_bytes == 256 << 20
    for line, expected in (
        ('chunk_bytes = "512 MB"', "limits.chunk_bytes: expected bytes"),
        ("chunk_bytes = -1", "limits.chunk_bytes"),
        ("record_bytes = 1", "limits.record_bytes"),
        ("image_pixels = 0", "limits.image_pixels"),
        (f"image_pixels = {(1 << 26) + 1}", "limits.image_pixels"),  # OpenCV refuses more
        ("chunk_byte = 1", "did you mean chunk_bytes"),
    ):
        with pytest.raises(ProfileError, match=expected):
            load_text(tmp_path, MINIMAL + f"[limits]\n{line}\n")
