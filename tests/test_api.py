"""The Python interface: what the documentation shows, and the columns of the command line."""

import math
import re
import subprocess
import sys

import numpy as np
import pytest

import svmdist
from svmdist.api import Estimates
from svmdist.estimation.frame import Frame
from svmdist.remote import RemoteFile
from svmdist.results import Distance, Distances, FrameResult
from svmdist.samples import Status
from svmdist.workflows.request import OwnEstimator, prepare
from tests.conftest import REPOSITORY

PAGES = ["README.md", *sorted(f"docs/{path.name}" for path in (REPOSITORY / "docs").glob("*.md"))]
EXAMPLES = {
    page: re.findall(r"```python\n(.*?)```", (REPOSITORY / page).read_text("utf-8"), re.DOTALL) for page in PAGES
}


@pytest.mark.parametrize("page", [page for page in PAGES if EXAMPLES[page]])
def test_examples_run_as_they_are_printed(page):
    for example in EXAMPLES[page]:
        command = [sys.executable, "-c", example]
        done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert done.stdout


def test_a_dataframe_has_the_columns_and_values_of_the_csv(golden, cli):
    pd = pytest.importorskip("pandas", reason="pandas has no wheel for this platform")
    log = golden / "occlusion.mcap"
    table = svmdist.estimate(svmdist.open_recording(log), "centroid", every=2).to_dataframe()
    rows = cli("estimate", log, "--method", "centroid", "--every", 2, "-f", "csv").rows
    assert isinstance(table, pd.DataFrame)
    assert list(table.columns) == list(rows[0])
    assert list(table["status"]) == [row["status"] for row in rows]
    expected = [float(row["distance_m"]) if row["distance_m"] else np.nan for row in rows]
    np.testing.assert_array_equal(table["distance_m"].to_numpy(float), expected)


def test_estimates_are_a_sequence_of_results(golden):
    recording = svmdist.open_recording(golden / "sweep.mcap", prepare().profile)
    estimates = svmdist.estimate(recording, "centroid")
    assert isinstance(estimates, Estimates)
    assert len(estimates) == len(list(estimates)) == 80
    assert estimates[0].measured
    score = svmdist.validate(recording, "centroid").primary
    assert score.sample_count == 80


def test_alarms_and_a_window_from_python(golden):
    """As the command line has them; a result shows itself in a few lines, and what it is of."""
    recording = svmdist.open_recording(golden / "3d" / "contact.mcap")
    estimates = svmdist.estimate(recording, alarms=svmdist.AlarmRules(0.05), start_s=1.0, end_s=2.0, every=5)
    assert [row["alarm"] for row in estimates.rows()] == [1, 1, 1]
    assert repr(estimates).startswith("contact: 3 rows by fused\n3 ok\nsmallest clearance")
    assert "1 alarm" in repr(estimates)
    assert repr(estimates).splitlines()[0] in estimates._repr_html_()
    assert set(dir(svmdist)) == set(svmdist.__all__)
    for window in ({"start_s": np.inf}, {"start_s": np.nan}, {"start_s": 2.0, "end_s": 1.0}):
        with pytest.raises(svmdist.errors.UsageError, match="--start"):
            svmdist.estimate(recording, **window)
    for none in ("none.mcap", RemoteFile("http://127.0.0.1:9/none.mcap")):  # as the `path` of a recording is
        with pytest.raises(svmdist.errors.RecordingError):
            svmdist.open_recording(none)


class Constant:
    """A method that measures the same distance always, and counts its frames."""

    def __init__(self) -> None:
        self.count = 0

    def estimate(self, frame: Frame) -> FrameResult:
        self.count += 1
        distances = Distances(planar=Distance(0.001 * self.count))
        return FrameResult(frame.stamp_ns, Status.OK, distances=distances)


def test_an_own_method_is_measured_and_each_instrument_has_its_own(golden):
    recording = svmdist.open_recording(golden / "3d" / "duo.mcap")
    results = svmdist.estimate(recording, Constant(), every=8)
    assert OwnEstimator(Constant()).name == "Constant"
    for name in ("PSM1", "PSM2"):
        own = [result.distances.planar for result in results if result.instrument == name]
        values = [distance.value_m for distance in own if distance is not None]
        np.testing.assert_allclose(values, 0.001 * np.arange(1, 11))


@pytest.mark.parametrize("distances", [Distances(), Distances(planar=Distance(math.nan))])
def test_an_own_method_is_not_taken_by_its_word(golden, distances):
    """A row that says ok has a number."""

    class Sure:
        def estimate(self, frame: Frame) -> FrameResult:
            return FrameResult(frame.stamp_ns, Status.OK, distances=distances)

    recording = svmdist.open_recording(golden / "3d" / "contact.mcap")
    assert {row.status for row in svmdist.estimate(recording, Sure(), every=40)} == {Status.NOT_FINITE}


def test_what_is_no_result_is_told(golden):
    class Wrong:
        def estimate(self, frame: Frame) -> float:
            return 3.0

    with pytest.raises(TypeError, match="expected a FrameResult, found float"):
        OwnEstimator(Wrong()).estimate(None)


def test_importing_is_light_and_an_unknown_name_has_choices():
    code = "import svmdist, sys; sys.exit('cv2' in sys.modules or 'numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
    assert re.fullmatch(r"\d+\.\d+\.\d+.*", svmdist.__version__)
    with pytest.raises(AttributeError, match="it has"):
        _ = svmdist.measure


def test_a_view_of_one_instrument_is_measured_as_that_instrument(golden):
    recording = svmdist.open_recording(golden / "3d" / "duo.mcap")
    both, one = (svmdist.estimate(seen, "kinematic", every=8) for seen in (recording, recording.for_instrument("PSM2")))
    expected = [row.distances.clearance for row in both if row.instrument == "PSM2"]
    assert [row.distances.clearance for row in one] == expected


def test_what_is_no_recording_frame_or_method_is_told(golden):
    recording = svmdist.open_recording(golden / "3d" / "contact.mcap")
    assert repr(recording).startswith("contact: instruments PSM1; image /ECM/left/image, ")
    below_5_mm = svmdist.AlarmRules(below_m=0.005)
    for call, expected in (
        (lambda: svmdist.open_recording(42), "expected the path or URL of a log, found int"),
        (lambda: svmdist.estimate("contact.mcap"), "what svmdist.open_recording gives, found str"),
        (lambda: svmdist.estimate([recording, recording]), "svmdist.open_recording gives, found list"),
        (lambda: svmdist.compare([recording, 3]), "what svmdist.open_recording gives, found int"),
        (lambda: svmdist.validate([]), "expected a recording or several, found none"),
        (lambda: svmdist.compare(()), "expected a recording or several, found none"),
        (lambda: svmdist.estimate(recording, 3), r"an object with estimate\(frame\); found int"),
        (lambda: svmdist.estimate(recording, every=0), "--every 0: expected 1 or more"),
        (lambda: svmdist.estimate(recording, every=2.5), "every: expected a whole number, found 2.5"),
        (lambda: svmdist.estimate(recording, start_s="2"), "start_s: expected a number, found '2'"),
        (lambda: svmdist.estimate(recording, lag="late"), "lag: expected a number, found 'late'"),
        (lambda: svmdist.estimate(recording, alarms=0.005), "alarms: expected AlarmRules, found 0.005"),
        (lambda: svmdist.estimate(recording, instruments="PSM1"), "a sequence of names, found 'PSM1'"),
        (lambda: svmdist.estimate(recording, "overlay", alarms=below_5_mm), "alarms need a clearance"),
        (lambda: svmdist.surface(recording, -1), "the number of an image, 0 or more; found -1"),
        (lambda: svmdist.compare(recording, "fuse"), "no method fuse: did you mean fused"),
    ):
        with pytest.raises(svmdist.errors.UsageError, match=expected):
            call()
