"""Wrong requests and wrong input: one line that says what to do, the exit code, no traceback and no file."""

import re
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from svmdist.cli.options import parse_length_m
from svmdist.errors import UsageError
from svmdist.samples import CameraSample, ImageSample, JointSample, Sample
from tests.conftest import REPOSITORY
from tests.shipped import PSM13, write_profile
from tests.synthetic import make_scene, right_of, samples, without, write_log, write_samples

CAMERA = "import images -o out.mcap --camera 60,61,31,23"
ALARM = "validate log.mcap --method fused --alarm-below 5mm --alarm-confidence"
ERRORS = [
    # What does not exist: commands, arguments, choices, with the nearest one.
    ("estimate", 2, "FILE"),
    ("estimat log.mcap", 2, "No such command 'estimat'. Did you mean 'estimate'? `svmdist -h` has examples."),
    ("import a.png b.png c.png", 2, "extra argument(s) (c.png). `svmdist import -h` has examples."),
    ("show log.mcap --frme 3", 2, "--frme (Possible options: --frame). `svmdist show -h` has examples."),
    ("estimate log.mcap -o", 2, "Option '-o' requires an argument."),
    ("validate", 2, "recordings"),
    ("estimate log.mcap --equations fixed", 2, "corrected"),
    ("estimate log.mcap -f xml", 2, "jsonl"),
    ("estimate log.mcap --method fuse", 2, "fuse: did you mean fused? The choices are: auto"),
    ("calibrate log.mcap -o a --method fused", 2, "fused: the choices are: centroid, overlay"),
    ("hand-eye log.mcap --method fused", 2, "fused: the choices are: fiducial, shaft, stereo"),
    ("record --scenario swep", 2, "swep: did you mean sweep? The choices are: approach"),
    ("record --degrade smok=3", 2, "did you mean smoke? The choices are: defocus, jpeg, low_light"),
    ("record --degrade smoke=6", 2, "a whole number from 1 to 5, found 6"),
    ("record --degrade smoke=3=4", 2, "expected NAME=SEVERITY, as in smoke=3"),
    ("record --renderer egl", 2, "leave the option out"),
    ("compare log.mcap --perturb focl=1", 2, "did you mean focal"),
    ("blur-bench log.mcap --kernel gausian=5", 2, "did you mean gaussian"),
    ("blur-bench log.mcap --kernel gaussian=4", 2, "an odd size"),
    ("estimate log.mcap --topic image", 2, "expected ROLE=TOPIC"),
    ("estimate log.mcap --topic imago=/left/image_raw", 2, "did you mean image?"),
    ("fk log.mcap --joints /a --topic joints=/b", 2, "--joints /a and --topic joints=/b: give one of them"),
    ("estimate log.mcap --topic image=/none", 1, "/ECM/left/image"),
    ("estimate log.mcap --topic image=/tf", 1, "/tf"),
    (
        "profile new log.mcap --topic image=/left/raw",
        1,
        "no topic /left/raw for image: did you mean /ECM/",
    ),
    ("profile new log.mcap --topic imag=/ECM/left/image", 2, "did you mean image?"),
    ("estimate log.mcap --instrument PSM9", 2, "no such instrument"),
    ("estimate log.mcap --instrument PSM2 --method kinematic", 1, "no topic of an instrument PSM2"),
    (
        "validate log.mcap --truth tf --truth-tf camera:needle",
        1,
        "no frame needle in the transforms: the choices are: base, camera",
    ),
    ("validate log.mcap --truth-tf a:b:c", 2, "a:b:c"),
    ("estimate *.bag", 2, "*.bag: no log matches"),
    # Values.
    ("estimate log.mcap --lag soon", 2, "expected auto or seconds"),
    ("estimate log.mcap --lag 1e9", 2, "within ±3600"),
    ("estimate log.mcap --start 3 --end 2", 2, "is before --start"),
    *(
        (f"{command} --start {start}", 2, "--start inf: expected seconds after the first image, as in 2.5")
        for command in ("estimate log.mcap", "fk log.mcap", "compare log.mcap", "hand-eye log.mcap")
        for start in ("inf", "1e400")
    ),
    ("fk log.mcap --start 1e300", 1, "no joint state is between --start and --end"),
    ("estimate log.mcap --start nan", 2, "--start nan: expected SECONDS, greater than or equal to 0"),
    ("estimate log.mcap --end 2s", 2, "--end 2s: expected SECONDS, a valid number"),
    ("estimate log.mcap -j 1.5", 2, "--jobs 1.5: expected N, a valid integer"),
    *(
        (f"show log.mcap --masks --at {at}", 2, f"--at {said}: the log has 0.5 s")
        for at, said in (("inf", "inf"), ("1e300", "1e+300"), ("0.501", "0.501"))
    ),
    ("validate log.mcap --group a,,b", 2, "expected names of metadata"),
    ("show log.mcap --frame 99", 2, "has 6 images, 0 to 5"),
    ("show log.mcap --masks --frame 99", 2, "has 6 images, 0 to 5"),
    (f"{ALARM} 1.5", 2, "--alarm-confidence"),
    (f"{ALARM} often", 2, "--alarm-confidence"),
    (f"{ALARM} 0.5 --alarm-when likely", 2, "the former name of --alarm-when: give one of them"),
    (
        "estimate log.mcap --method fused --alarm-below 5mm --alarm-when often",
        2,
        "possible, likely, certain, or a",
    ),
    ("estimate log.mcap --alarm-when likely", 2, "--alarm-when is for --alarm-below LENGTH"),
    # Options that need each other, or exclude each other.
    ("estimate log.mcap --equations printed --calibration c.toml", 2, "calibration"),
    ("estimate log.mcap --equations printed --method fused", 2, "measures in 3D"),
    ("estimate log.mcap --calibration c.toml --method shaft", 2, "measures in 3D"),
    ("estimate log.mcap --method overlay --alarm-below 5mm", 2, "fused"),
    ("validate log.mcap --method centroid --alarm-below 5mm", 2, "fused"),
    ("validate log.mcap --alarm-confidence 0.5", 2, "--alarm-below"),
    ("validate log.mcap --plot time", 2, "--save-plot FILE"),
    ("estimate log.mcap --group world", 2, "--summary FILE"),
    ("compare log.mcap --jobs 2 --scheduler tcp://x:1", 2, "leave out one"),
    ("record --skip-existing", 2, "goes with --episodes"),
    ("show log.mcap --frame 1 --worst 2", 2, "give one of them"),
    ("show log.mcap --masks --worst 2", 2, "--masks"),
    # Output.
    ("estimate log.mcap -o a.html --report b.html", 2, "leave out one"),
    ("estimate log.mcap -o a.csv --summary ./a.csv", 2, "-o and --summary are both a.csv: give each a file"),
    (
        "estimate log.mcap --report a.html --save-plot images/../a.html",
        2,
        "--report and --save-plot are both",
    ),
    ("validate log.mcap -o a.json --write-baseline a.json", 2, "-o and --write-baseline are both a.json"),
    ("compare log.mcap -o a.png --save-plot a.png", 2, "-o and --save-plot are both a.png"),
    *(
        (f"{command} log.mcap --profile sizeless.toml {given} ./sizeless.toml", 2, "is what --profile reads")
        for command, given in (("estimate", "--report"), ("info", "-o"), ("fk", "-o"))
    ),
    ("validate log.mcap --estimates a=rows.csv -o rows.csv", 2, "is what --estimates reads"),
    *(
        (f"{command} -", 2, f"{command.split()[-1]} -: expected the name of a file")
        for command in ("estimate log.mcap --summary", "calibrate log.mcap -o", "hand-eye log.mcap -o")
    ),
    *(
        (f"{command} log.mcap -o a.json", 2, "-o a.json: is written as TOML: give it the ending .toml")
        for command in ("calibrate", "hand-eye", "profile new")
    ),
    ("estimate log.mcap --summary a.foo", 2, "--summary a.foo: no format has the ending .foo"),
    ("estimate log.mcap -o a.mp4 --report b.html", 2, "by itself"),
    ("estimate log.mcap -o a.mcap --resume x", 2, "by itself"),
    ("estimate log.mcap --summary s.csv -o a.mp4", 2, "write a.mp4 by itself"),
    ("estimate log.mcap -f csv -o a.mcap", 2, "leave out one of them"),
    ("estimate log.mcap -f parquet", 2, "is no text"),
    ("estimate log.mcap -o a.avi", 2, "no format has the ending .avi"),
    ("estimate log.mcap two.mcap -o a.mcap", 2, "holds one recording"),
    ("fk log.mcap two.mcap -f tum", 2, "one trajectory"),
    ("validate log.mcap --report report.pdf", 2, ".html"),
    ("estimate none.mcap --save-plot a.jpeg", 2, "cannot draw a .jpeg: the choices are png, svg, pdf"),
    ("estimate none.mcap --save-plot plot", 2, "--save-plot plot: cannot draw a file without an ending"),
    ("validate log.mcap --save-plot nowhere/plot.png", 1, "plot.png: cannot write: there is no folder"),
    ("show log.mcap -o six.png", 2, "6 are asked for"),
    ("show log.mcap --frame 3 -o seen.pdf", 2, "in .png, or a folder"),
    *((f"{name} log.mcap -o nowhere/a.csv", 1, "nowhere") for name in ("estimate", "validate", "blur-bench")),
    *(
        (f"{name} log.mcap -o log.mcap", 2, "is the recording to read")
        for name in ("info", "fk", "estimate", "validate", "compare", "blur-bench")
    ),
    ("estimate log.mcap -f csv -o /dev/full", 1, "/dev/full"),
    # Files that are not what they should be, or lack something.
    ("estimate blind.mcap", 1, "/PSM1/measured_js"),
    ("info link.mcap", 1, "link.mcap: no such file: it is a link to nowhere.mcap"),
    ("show .", 2, ".: expected one log, found blind.mcap, "),
    (
        "show log.mcap --profile https://x.org/a.toml",
        1,
        "a URL, which only logs may be; fetch the file first",
    ),
    ("estimate small.mcap --method overlay", 1, "320x240"),
    ("estimate red\x1b[31m.mcap", 1, "red\N{REPLACEMENT CHARACTER}[31m.mcap: is not a recording"),
    (
        "estimate log.mcap --profile key.toml",
        1,
        "key.toml: unknown key segmentation.tissue.min_aera_px",
    ),
    ("estimate log.mcap --profile none.json", 1, "none.json: no such file; a profile is a .toml"),
    (
        "estimate log.mcap --profile none.toml",
        1,
        "no such file; `svmdist profile new LOG -o none.toml` writes",
    ),
    ("estimate log.mcap --profile sizeles.toml", 1, "no such file: did you mean sizeless.toml?"),
    *(
        (
            f"{command} foreign.mcap",
            1,
            "foreign.mcap: not a log of profile psm13, the simulator's: write one with",
        )
        for command in ("estimate", "validate", "compare", "show")
    ),
    ("estimate log.mcap --method overlay --profile uncalibrated.toml", 1, "svmdist calibrate"),
    ("profile new junk.mcap", 1, "junk.mcap"),
    ("profile new none.mcap", 1, "none.mcap"),
    ("fk log.mcap --hand-eye none.toml", 1, "none.toml: cannot read"),
    ("hand-eye recordings/3d/contact.mcap --method fiducial --end 3", 1, "move the tool further"),
    *(
        (f"{name} log.mcap --profile sizeless.toml --method fused --alarm-below 5mm", 1, "no [instrument]")
        for name in ("estimate", "validate")
    ),
    # The surface by two views.
    ("surface log.mcap", 1, "needs a calibrated right view"),
    ("surface recordings/3d/contact.mcap --frame 99", 2, "80 images, 0 to 79"),
    ("surface recordings/3d/contact.mcap --frame 1 --at 2", 2, "give one of them"),
    ("surface recordings/3d/contact.mcap -o x.stl", 2, ".ply"),
    # Import.
    ("import images -o out.mcap", 2, "a camera needs a calibration: --calibration FILE, or --camera"),
    ("import images -o out.mcap --camera 60,60", 2, "--camera 60,60: expected FX,FY,CX,CY"),
    ("import images -o out.mcap --camera 60,60,1,x", 2, "expected numbers between commas"),
    ("import images -o out.mcap --camera 60,61,310,23 --rate 1", 1, "principal point (310, 23) is outside"),
    ("import images -o out.mcap --calibration no.yaml --rate 1", 1, "no.yaml: cannot read: No such file"),
    ("import images -o out.mcap --right-camera 60,61,31,23", 2, "--right-camera goes with --camera"),
    (f"{CAMERA} --rate 1".replace("mcap", "csv"), 2, "is written as MCAP: give it the ending .mcap"),
    (CAMERA.replace("images", "log.mcap"), 2, "log.mcap: is a log already, which needs no import"),
    (CAMERA, 2, "img0.png has no time"),
    (f"{CAMERA} --rate 1 --joint-names yaw", 2, "--joint-names goes with --joints"),
    (
        f"{CAMERA} --times times.csv --start 5",
        2,
        "--start goes with --rate or a video; times are those of times",
    ),
    *(
        (f"{CAMERA} --rate 1 {name} {given}", 2, f"{name} is of two views: name the right one, or say --side")
        for name, given in (("--right-camera", "60,61,31,23"), ("--right-calibration", "no.yaml"))
    ),
    (f"{CAMERA} --rate 0", 2, "--rate 0: expected HZ, greater than or equal to 0.001"),
    (f"{CAMERA} --unit inch", 2, "'--unit': inch: the choices are: cm, m, mm"),
    (f"{CAMERA} --baseline 5mm", 2, "--baseline is of two views"),
    (f"{CAMERA} --distortion 0.1,0.2 --rate 1", 2, "--distortion: expected 4, 5"),
    (f"{CAMERA} --times no.csv", 1, "no.csv: cannot read"),
    (f"{CAMERA} --rate 1 --times no.csv", 2, "cannot be combined"),
    (f"{CAMERA} --rate 1 --poses no.csv", 1, "no.csv: cannot read"),
    (f"{CAMERA} --rate 1 --start soon", 2, "--start soon: expected a time"),
    (f"{CAMERA} --rate 1 --poses a.csv --poses b.csv", 2, "two files for the"),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("errors")
    write_log(made / "log.mcap", frame_count=6)
    write_log(made / "two.mcap", frame_count=1)
    write_log(made / "foreign.mcap", frame_count=2, change=without("PSM1"))
    write_log(made / "blind.mcap", frame_count=3, change=without("image"))
    write_log(made / "small.mcap", make_scene(320, 240), frame_count=3)
    (made / "junk.mcap").write_text("junk")
    (made / "link.mcap").symlink_to("nowhere.mcap")
    (made / "red\x1b[31m.mcap").write_text("junk")
    (made / "key.toml").write_text('name = "a"\n[segmentation.tissue]\nhue = [170, 8]\nmin_aera_px = 50\n')
    (made / "sizeless.toml").write_text(re.sub(r"\[instrument\]\n(.+\n)+", "", PSM13))
    (made / "times.csv").write_text("time_s\n0\n1\n")
    (made / "rows.csv").write_text("stamp,distance_m\n0,0.01\n")
    write_profile(made / "uncalibrated.toml")
    (made / "recordings").mkdir()
    (made / "recordings" / "3d").symlink_to(REPOSITORY / "recordings" / "3d")
    (made / "images").mkdir()
    for number in range(2):
        cv2.imwrite(str(made / "images" / f"img{number}.png"), np.full((48, 64, 3), 90, np.uint8))
    return made


@pytest.mark.parametrize(("request_", "code", "said"), ERRORS, ids=[request for request, *_ in ERRORS])
def test_a_wrong_request_is_one_line(cli, folder, monkeypatch, request_, code, said):
    monkeypatch.chdir(folder)
    before = {path: path.lstat().st_mtime_ns for path in folder.iterdir()}
    outcome = cli(*request_.split(" "), code=code)
    assert outcome.out == ""
    assert said in outcome.line
    assert "\x1b" not in outcome.err
    assert {path: path.lstat().st_mtime_ns for path in folder.iterdir()} == before


def test_lengths_have_a_unit():
    for text in ("5mm", "5 mm", "0.5cm", "0.005m"):
        assert parse_length_m("--alarm-below", text) == pytest.approx(0.005)
    for text in ("5", "mm", "-5mm", "0mm", "nanmm", "5in", "1e9m", ""):
        with pytest.raises(UsageError, match="as in 5mm"):
            parse_length_m("--alarm-below", text)


@pytest.mark.parametrize(
    ("method", "said"),
    [("fused", "no_joints (no joints near the image)"), ("stereo", "no_stereo (no right view)")],
)
def test_a_method_says_what_the_log_lacks(cli, tmp_path, method, said):
    """Frames without what a method needs are rows with a reason, the last but one line has it, and then `info`."""
    path = write_log(tmp_path / "still.mcap", frame_count=3, change=without("PSM1"))
    outcome = cli("estimate", path, "--method", method, "-f", "csv", code=1)  # nothing was measured
    assert outcome.err.splitlines() == [
        f"svmdist: 0 of 3 frames measured (0.0%); 3 {said}",
        f"svmdist: next: svmdist info {path}",
    ]
    assert [f"{row['status']} ({row['detail']})" for row in outcome.rows] == [said] * 3


def test_an_option_that_counts_once_says_so_where_it_is_given_twice(cli, tmp_path):
    path = write_log(tmp_path / "still.mcap", frame_count=2)
    twice = cli("fk", path, "--every", 1, "--every", 100, "-v", "-v")
    assert "svmdist: note: --every is given 2 times, of which the last one counts" in twice.err
    assert len(twice.rows) == 1
    assert "--verbose" not in twice.err


def test_what_is_guessed_is_said(cli, tmp_path):
    """Intervals are as wide as a radius that nobody measured; of the simulator's profile nothing is a guess."""
    log = write_log(tmp_path / "still.mcap", frame_count=2)
    radius = "shaft_radius_m = 0.004", "shaft_radius_m = 0.004\nshaft_radius_std_fraction = 0.25"
    guessed = write_profile(tmp_path / "guessed.toml", radius)
    said = "so that distances are as unsure: shaft_radius_m to 25%"
    for profile, is_said in ((guessed, True), ("psm13", False)):
        outcome = cli("estimate", log, "--method", "kinematic", "--profile", profile, "-f", "csv")
        assert (said in outcome.err) == is_said


def test_views_that_never_meet_are_said(cli, tmp_path):
    """Stamps of the right view 50 ms late: one line says how far apart the nearest are, in estimate and validate."""

    def pairs() -> Iterator[tuple[str, Sample]]:
        scene = make_scene()
        for topic, sample in samples(scene, 4):
            yield topic, sample
            if isinstance(sample, ImageSample):
                late = replace(sample, stamp_ns=sample.stamp_ns + 50_000_000)
                yield "/ECM/right/camera_info", CameraSample(late.stamp_ns, right_of(scene.camera))
                yield "/ECM/right/image", late

    path = write_samples(tmp_path / "late.mcap", pairs())
    said = "svmdist: right image never within 0.5 ms of the left (nearest 50 ms): measured with one camera"
    for command in ("estimate", "validate"):
        assert said in cli(command, path, "--method", "fused").err


@pytest.mark.parametrize("place_m", [1000.0, 1e8, -1e8])
def test_joints_where_no_joint_can_be(cli, tmp_path, place_m):
    """An instrument that is a kilometre in is not believed: no row is `ok`, and the joint is named."""

    def far_away(_: str, sample: Sample) -> Sample:
        if not isinstance(sample, JointSample):
            return sample
        positions = sample.positions.copy()
        positions[sample.names.index("insertion")] = place_m
        return replace(sample, positions=positions)

    path = write_log(tmp_path / "far.mcap", frame_count=3, change=far_away)
    for method in ("kinematic", "fused"):
        line, _ = cli("estimate", path, "--method", method, "-f", "csv", code=1).err.splitlines()
        assert line.startswith("svmdist: 0 of 3 frames measured (0.0%); 3 no_joints (joint insertion is at ")
    for command in ("validate", "compare"):
        assert cli(command, path, "--method", "kinematic", code=1).err.endswith("svmdist: no frame is measured\n")


def test_of_a_file_that_is_cut_the_readable_frames_are_measured(cli, tmp_path, synthetic_log):
    """The loss is said and the exit code is 3."""
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(synthetic_log.read_bytes()[: synthetic_log.stat().st_size // 2])
    outcome = cli("estimate", cut, "-f", "csv", "--every", 4, code=3)
    whole = cli("estimate", synthetic_log, "-f", "csv", "--every", 4).out.splitlines()
    rows = [line.replace("cut,", "synthetic,") for line in outcome.out.splitlines()]
    assert "truncated at byte" in outcome.err
    assert 2 < len(rows) < len(whole)
    assert rows == whole[: len(rows)]
    assert not cli("info", cut, "-f", "json", code=3).json["is_clean"]


def test_a_profile_limits_what_a_log_may_ask(cli, tmp_path, synthetic_log):
    """What is above `[limits]` of the profile is a loss."""
    profile = tmp_path / "strict.toml"
    profile.write_text(PSM13 + "\n[limits]\nimage_pixels = 1000\n")
    options = ("--profile", profile, "--equations", "printed", "-f", "csv")
    outcome = cli("estimate", synthetic_log, *options, code=3)
    assert "the limit is 1000" in outcome.err
    assert outcome.out.count("corrupt_image") == 40


def test_record_without_pybullet_says_why(cli, tmp_path, monkeypatch):
    """Where PyBullet is missing, `record` says why and what to do, and leaves no file."""
    monkeypatch.setitem(sys.modules, "pybullet", None)
    outcome = cli("record", "--duration", "0.5", "-o", tmp_path / "sweep.mcap", code=1)
    assert "svmdist[sim]" in outcome.line
    assert list(tmp_path.iterdir()) == []
