"""What a recorded frame costs: run with `uv run pytest tests/benchmarks/test_record_speed.py --benchmark-enable`.

Whole recordings of a few frames with one process and with all cores, and the steps of one frame beside each other.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from svmdist.profile import load_profile
from svmdist.recording.messages.encoding import encode, encode_all
from svmdist.samples import ImageSample, Sample
from svmdist.simulation.scene import Extras
from svmdist.simulation.scenarios import Scenario
from svmdist.simulation.scene import make_scene
from svmdist.simulation.simulate import Sensor

pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
from svmdist.simulation.clearance import ClearanceMeter
from svmdist.simulation.render import DrawnWorld
from svmdist.simulation.plan import Plan, make_plan
from svmdist.simulation.render import Renderer
from svmdist.simulation.simulate import Simulator
from svmdist.workflows.ahead import usable_cores
from svmdist.workflows.record import record

FRAMES = 32


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    """OpenCV's threads would hide what a step costs."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    yield
    cv2.setNumThreads(before)


@pytest.fixture(scope="module")
def plan() -> Plan:
    return make_plan(Scenario("sweep", 1, FRAMES / 10.0, 10.0), load_profile())


@pytest.fixture(scope="module")
def block(plan: Plan) -> list[tuple[str, Sample]]:
    """The samples of the first tenth of a second."""
    with Simulator(plan) as simulator:
        return list(simulator.samples(plan.blocks[0], simulator.draw_noise()))


@pytest.mark.benchmark(group=f"recording of {FRAMES} frames")
@pytest.mark.parametrize("jobs", [1, usable_cores()], ids=["one process", "all cores"])
def test_record(benchmark: BenchmarkFixture, tmp_path: Path, jobs: int) -> None:
    """The start of the worlds and of the processes is in it, as in a short recording."""
    scenario = Scenario("sweep", 1, FRAMES / 10.0, 10.0)
    run = benchmark.pedantic(
        record,
        (scenario, load_profile(), tmp_path / "log.mcap"),
        {"force": True, "jobs": jobs},
        rounds=3,
    )
    assert run.frame_count == FRAMES


@pytest.mark.benchmark(group="steps of a frame")
def test_drawing(benchmark: BenchmarkFixture, plan: Plan) -> None:
    """The moving bodies before the background."""
    with Renderer(plan.scene) as renderer:
        renderer.frame_of(plan.arms[0].q[0])
        renderer.frame_of(plan.arms[0].q[0])  # both backgrounds are there
        benchmark(renderer.frame_of, plan.arms[0].q[0])


@pytest.mark.benchmark(group="steps of a frame")
def test_drawing_everything(benchmark: BenchmarkFixture, plan: Plan) -> None:
    """The same image as one picture of all bodies, as it was drawn before."""
    with Renderer(plan.scene) as renderer, DrawnWorld(plan.scene, still=True, moving=True) as world:
        world.pose(plan.arms[0].q[0], None, ())
        benchmark(lambda: world.picture(renderer.view, renderer.projection, world.turn))


@pytest.mark.benchmark(group="steps of a frame")
def test_noise(benchmark: BenchmarkFixture) -> None:
    sensor, image = Sensor(0, 1, 2.0, Extras()), np.full((480, 640, 3), 100, np.uint8)
    benchmark(lambda: sensor.expose(image, sensor.draw_noise(640, 480), 0))


@pytest.mark.benchmark(group="steps of a frame")
def test_png(benchmark: BenchmarkFixture, block: list[tuple[str, Sample]]) -> None:
    """Encoding the image: a copy per round, since nothing is cached."""
    image = next(sample for _, sample in block if isinstance(sample, ImageSample))
    benchmark(encode, image)


@pytest.mark.benchmark(group="steps of a frame")
def test_other_messages(benchmark: BenchmarkFixture, block: list[tuple[str, Sample]]) -> None:
    """Joints, transforms and truth of ten stamps."""
    others = [pair for pair in block if not isinstance(pair[1], ImageSample)]
    assert len(benchmark(encode_all, others)) == len(others)


@pytest.mark.benchmark(group="steps of a frame")
def test_clearance(benchmark: BenchmarkFixture, plan: Plan) -> None:
    """The true clearance at ten stamps."""
    scene = make_scene(load_profile(), 1)
    with ClearanceMeter(scene) as meter:
        benchmark(lambda: [meter.clearance_m(q) for q in plan.arms[0].q[:10]])
