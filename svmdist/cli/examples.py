"""Examples of every command, as `--help` shows them: what for, and what to type."""

from __future__ import annotations

from typing import NamedTuple


class Example(NamedTuple):
    """A purpose, and the command line that serves it, at most 76 characters long."""

    purpose: str
    command: str


EXAMPLES: dict[str, tuple[Example, ...]] = {
    "svmdist": (
        Example("What a log holds, and which methods it can serve", "svmdist info log.mcap"),
        Example("A row per frame", "svmdist estimate log.mcap --method fused -o rows.csv"),
        Example("Errors against the truth, as a page", "svmdist validate log.mcap --report report.html"),
    ),
    "import": (
        Example(
            "Images at 30 per second, of a camera in numbers",
            "svmdist import images --rate 30 --camera 572,572,320,240 -o log.mcap",
        ),
        Example(
            "Two views of a video side by side, with the pair's calibration",
            "svmdist import video.mp4 --side-by-side --calibration stereo.yaml",
        ),
        Example(
            "With joints of the robot, a column for each",
            "svmdist import images --rate 30 --camera 572,572,320,240 --joints q.csv",
        ),
    ),
    "info": (
        Example("Topics, cameras, and the methods that the log can serve", "svmdist info log.mcap"),
        Example("The same of a log with a profile of one's own", "svmdist info log.mcap --profile mine.toml"),
        Example("For a program", "svmdist info log.mcap -f json"),
    ),
    "show": (
        Example("Each step of a method in one frame", "svmdist show log.mcap --frame 40 --method fused"),
        Example("The three worst frames", "svmdist show log.mcap --worst 3 --method fused -o pictures"),
        Example("What is segmented, in six frames", "svmdist show log.mcap --masks"),
    ),
    "record": (
        Example("Eight seconds in which the tool touches the tissue", "svmdist record --scenario contact"),
        Example(
            "Two cameras, a tag, and errors as real robots have them",
            "svmdist record --stereo --tag --world real --seed 7 -o real-7.mcap",
        ),
    ),
    "calibrate": (
        Example("Fit on a log with ground truth", "svmdist calibrate calibration.mcap -o camera.toml"),
        Example(
            "On its second half, and use the result",
            "svmdist calibrate calibration.mcap --start 4 -o half.toml",
        ),
        Example("Use a calibration", "svmdist validate log.mcap --calibration camera.toml"),
    ),
    "estimate": (
        Example("A row per frame, as CSV", "svmdist estimate log.mcap --method fused -o rows.csv"),
        Example(
            "Alarms where the clearance may be below 5 mm",
            "svmdist estimate log.mcap --method fused --alarm-below 5mm",
        ),
        Example(
            "For Foxglove, Lichtblick and Rerun, or as a video",
            "svmdist estimate log.mcap --method fused -o seen.mcap",
        ),
        Example(
            "Seconds 2 to 5, every fourth image, as a video",
            "svmdist estimate log.mcap --start 2 --end 5 --every 4 -o seen.mp4",
        ),
    ),
    "validate": (
        Example("Errors against the truth", "svmdist validate log.mcap --method fused"),
        Example(
            "A page with plots and the worst frames",
            "svmdist validate log.mcap --method fused --report report.html",
        ),
        Example("A figure for a paper", "svmdist validate log.mcap --save-plot error.pdf --plot residuals"),
        Example(
            "In CI: fail where a figure gets worse", "svmdist validate log.mcap --baseline baseline.json"
        ),
    ),
    "compare": (
        Example("All methods on the same frames", "svmdist compare log.mcap"),
        Example(
            "Two of them, also in smoke",
            "svmdist compare log.mcap --method fused --method shaft --degrade smoke=3",
        ),
        Example(
            "A table and a figure for a paper", "svmdist compare log.mcap -f latex --save-plot methods.pdf"
        ),
    ),
    "blur-bench": (
        Example("Table I of the paper, measured", "svmdist blur-bench log.mcap"),
        Example(
            "Error and coverage of a method in smoke and as JPEG",
            "svmdist blur-bench log.mcap --grid --method fused --degradations smoke,jpeg",
        ),
        Example(
            "Every fifth image, with a figure",
            "svmdist blur-bench log.mcap --grid --every 5 --save-plot blur.pdf",
        ),
    ),
    "fk": (
        Example("The tool's pose for each joint state", "svmdist fk log.mcap -o poses.csv"),
        Example("In the camera's frame, for evo", "svmdist fk log.mcap --in-camera -o poses.tum"),
    ),
    "hand-eye": (
        Example(
            "Fit by the tag on the instrument", "svmdist hand-eye log.mcap --method fiducial -o hand-eye.toml"
        ),
        Example("Use the transform", "svmdist estimate log.mcap --method fused --hand-eye hand-eye.toml"),
    ),
    "profile": (Example("A first profile of a log", "svmdist profile new log.mcap -o mine.toml"),),
    "profile new": (
        Example("A commented profile, to be completed by hand", "svmdist profile new log.mcap -o mine.toml"),
        Example(
            "With a camera's topic that is none of the usual ones",
            "svmdist profile new log.mcap --topic image=/left/image_raw",
        ),
    ),
}
"""By the command's name, with that of its group before it."""
