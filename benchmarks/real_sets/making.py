"""From a set's files to results: import, profile and estimate as a user would run them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from svmdist.errors import SvmdistError
from svmdist.profile import Profile, load_profile
from svmdist.profile.hand_eye import save_hand_eye
from svmdist.recording.log import open_recording
from svmdist.report.info import hand_eye_file
from svmdist.report.profile_template import profile_lines
from svmdist.results import Failure, FrameResult
from svmdist.workflows.estimate import estimate
from svmdist.workflows.hand_eye import HandEyeResult, hand_eye
from svmdist.workflows.import_log import ImportOptions, import_log
from svmdist.workflows.new_profile import draft_profile
from svmdist.workflows.request import prepare


def make_log(options: ImportOptions, path: Path) -> Path:
    """Import, in place of an earlier log."""
    path.parent.mkdir(parents=True, exist_ok=True)
    import_log(options, path, force=True)
    return path


def make_profile(log: Path, changes: Mapping[str, str] | None = None) -> Path:
    """What `profile new` writes, with some of its lines replaced by others."""
    text = "".join(f"{line}\n" for line in profile_lines(draft_profile(log, log.stem, {})))
    for old, new in (changes or {}).items():
        text = text.replace(old, new)
    path = log.with_suffix(".toml")
    path.write_text(text, "utf-8")
    load_profile(path)
    return path


def make_hand_eye(log: Path, profile: Path, method: str, instrument: str) -> Path | str:
    """The hand-eye file of a log; or why there is none."""
    setup = prepare(profile, method)
    recording = open_recording(log, setup.profile)
    found = hand_eye(recording, setup, instrument)
    if isinstance(found, Failure):
        return found.reason
    assert isinstance(found, HandEyeResult)
    path = log.with_name(f"{log.stem}-hand-eye.toml")
    save_hand_eye(path, hand_eye_file([found], recording))
    return path


def run(
    log: Path, profile: Path, method: str, hand_eye_path: Path | None = None
) -> tuple[list[FrameResult], Profile] | str:
    """The rows of a method; or why it cannot measure."""
    try:
        setup = prepare(profile, method, hand_eye=hand_eye_path)
        return list(estimate(open_recording(log, setup.profile), setup)), setup.profile
    except SvmdistError as problem:
        return str(problem)
