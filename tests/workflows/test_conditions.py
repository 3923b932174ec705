"""Conditions change images by a frame's number and content alone; other worlds are groups of their own."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from svmdist.errors import UsageError
from svmdist.perturbations import TABLE, Perturbations, parse_perturbations
from svmdist.recording.log import Recording, open_recording
from svmdist.samples import Observation, RightView
from svmdist.vision.degradations import Blur, Degradation
from svmdist.workflows.compare import MethodScore, compare, group_of
from svmdist.workflows.request import CLEAN, Condition, Setup, prepare
from tests.shipped import PROFILE
from tests.synthetic import make_scene, write_log

SMALL_SCENE = make_scene(320, 240)
IMAGE = SMALL_SCENE.frame_at(0.3)
SEEN = Observation(
    5,
    IMAGE,
    SMALL_SCENE.camera,
    None,
    RightView(np.ascontiguousarray(IMAGE[:, ::-1]), SMALL_SCENE.camera, np.eye(4)),
    np.eye(4),
)
EVERY: list[Condition] = [
    *(Condition(name, 3) for name in Degradation),
    Condition(Blur.GAUSSIAN, 5),
]


def same(first: Observation, second: Observation) -> bool:
    return np.array_equal(first.image_bgr, second.image_bgr) and np.array_equal(
        first.right.image_bgr, second.right.image_bgr
    )


@pytest.mark.parametrize("condition", EVERY, ids=str)
def test_a_frame_is_always_changed_alike(condition):
    """Both its images and nothing else, whatever came before; a view that is missing changes nothing of the other."""
    before = IMAGE.copy()
    changed = condition.apply(SEEN, 3)
    assert not np.array_equal(changed.image_bgr, SEEN.image_bgr)
    assert not np.array_equal(changed.right.image_bgr, SEEN.right.image_bgr)
    assert (changed.image_bgr.shape, changed.image_bgr.dtype) == (IMAGE.shape, IMAGE.dtype)
    assert replace(changed, image_bgr=SEEN.image_bgr, right=SEEN.right) == SEEN
    condition.apply(SEEN, 8)
    assert same(condition.apply(SEEN, 3), changed)
    one_view = condition.apply(replace(SEEN, right=None), 3)
    assert one_view.right is None
    np.testing.assert_array_equal(one_view.image_bgr, changed.image_bgr)
    np.testing.assert_array_equal(before, SEEN.image_bgr)


@pytest.mark.parametrize("name", sorted({*Degradation} - {Degradation.DEFOCUS, Degradation.JPEG}))
def test_what_is_drawn_changes_with_frame_and_log(name):
    """Another number, or another image of that number as another log has it, draws anew."""
    condition = Condition(name, 3)
    once = condition.apply(SEEN, 3)
    assert not same(condition.apply(SEEN, 4), once)
    other = IMAGE.copy()
    other[0, 0] ^= 1
    drawn = condition.apply(replace(SEEN, image_bgr=other), 3).image_bgr
    assert np.count_nonzero(drawn != once.image_bgr) > 100  # one pixel and its neighbours would be 3 to 30


@pytest.mark.parametrize("severity", [-1, 0, 6])
def test_a_severity_is_1_to_5(severity):
    with pytest.raises(UsageError, match="5"):
        Condition(Degradation.NOISE, severity)
    assert str(Condition(Degradation.NOISE, 5)) == f"{Degradation.NOISE}=5"


SMOKE = Condition(Degradation.SMOKE, 3)


def perturbed(text: str) -> Condition:
    return Condition(world=parse_perturbations(text))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    path = tmp_path_factory.mktemp("logs") / "drawn.mcap"
    write_log(path, frame_count=8, metadata={"scenario": "sweep", "seed": "5"})
    return open_recording(path, PROFILE)


@pytest.fixture(scope="module")
def setups(synthetic_calibration: Path) -> list[Setup]:
    return [prepare(method="kinematic"), prepare(method="centroid", calibration=synthetic_calibration)]


def rmse_m(scores: list[MethodScore], method: str) -> dict[str, float]:
    return {
        score.group.degradation: score.figures.spatial.statistics.rmse
        for score in scores
        if score.method == method and score.figures.spatial is not None
    }


def test_every_world_is_a_group_and_each_changes_what_it_concerns(log, setups):
    """A late robot is wrong about its tool; a wrong plane, about what is seen of the tissue."""
    conditions = [CLEAN, perturbed("lag=50"), SMOKE, perturbed("plane=3"), perturbed("plane=3,lag=50")]
    scores = compare([log], setups, conditions, jobs=1)
    named = dict.fromkeys(score.group.degradation for score in scores)
    assert list(named) == ["", "lag=50", "smoke=3", "plane=3", "plane=3,lag=50", "all"]
    clean, late, smoked, off, both, _ = rmse_m(scores, "kinematic").values()
    alone = rmse_m(compare([log], setups[:1], jobs=1), "kinematic")[""]
    assert clean == alone
    assert late != clean
    assert abs(off - clean) > 1e-3
    assert both not in (off, late)
    assert smoked == pytest.approx(clean, rel=0.5)


def test_planar_methods_keep_their_calibration(log, setups):
    """Their mapping is of the camera that took the images, whatever a perturbed log says of it."""
    planar = [
        score.figures.planar
        for score in compare([log], setups[1:], [CLEAN, perturbed("focal=2,lag=30")], jobs=1)
        if score.group.scenario == "sweep" and score.group.degradation != "all"
    ]
    assert planar[0].statistics == planar[1].statistics


def test_a_log_says_what_world_it_was_recorded_in(tmp_path):
    def group(**metadata: str) -> str:
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}.mcap"
        write_log(path, frame_count=2, metadata={"scenario": "sweep", **metadata})
        return group_of(open_recording(path, PROFILE), perturbed("lag=5")).degradation

    assert group() == "lag=5"
    assert group(perturb="focal=1") == "focal=1,lag=5"
    assert group(perturb="focal=1", degrade="smoke=3") == "smoke=3,focal=1,lag=5"
    assert group(perturb="focal=1,plane=2", world="real") == "world=real,lag=5"


def test_a_perturbed_recording_is_perturbed_for_each_of_its_instruments(log):
    world = log.perturbed(parse_perturbations("focal=1,joint_noise=1"))
    (name,) = world.instruments
    view = world.for_instrument(name)
    np.testing.assert_array_equal(view.camera.K, world.camera.K)
    np.testing.assert_array_equal(view.joint_track().positions, world.joint_track().positions)
    assert (world.joint_track().positions != log.joint_track().positions).any()
    assert world.world.seed == 5
    assert log.world.seed == 0
    assert world.right_camera is None


def test_a_world_changes_images_only_where_it_concerns_them():
    image = np.random.default_rng(1).integers(0, 255, (48, 64, 3)).astype(np.uint8)
    seen = Observation(1, image, make_scene(64, 48).camera, None)
    assert (perturbed("zoom=1.2").apply(seen, 0).image_bgr != image).any()
    assert perturbed("focal=1").apply(seen, 0).image_bgr is image


def test_a_replay_refuses_what_must_be_recorded(monkeypatch):
    entry = replace(TABLE["focal"], name="nowhere", at_replay=False)
    monkeypatch.setitem(TABLE, "nowhere", entry)
    with pytest.raises(UsageError, match="nowhere cannot be applied at replay: the choices are backlash"):
        Condition(world=Perturbations((("nowhere", 1.0),)))
