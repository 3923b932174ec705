"""`svmdist estimate -o`: the format by the file's ending, and files that exist."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from svmdist.profile import load_profile
from svmdist.recording.log import open_recording
from tests.cli.conftest import Cli


@pytest.fixture
def log(synthetic_log: Path) -> Path:
    return synthetic_log


def test_the_ending_chooses_the_format(cli: Cli, log: Path, tmp_path: Path) -> None:
    for ending in ("csv", "json", "jsonl"):
        assert cli("estimate", log, "-o", tmp_path / f"out.{ending}").code == 0
    rows = list(csv.DictReader((tmp_path / "out.csv").read_text().splitlines()))
    assert rows == [
        {key: "" if value is None else str(value) for key, value in row.items()}
        for row in json.loads((tmp_path / "out.json").read_text())
    ]
    lines = [json.loads(line) for line in (tmp_path / "out.jsonl").read_text().splitlines()]
    assert lines == json.loads((tmp_path / "out.json").read_text())


def test_a_dash_is_stdout(cli: Cli, log: Path) -> None:
    assert cli("estimate", log, "-f", "csv", "-o", "-").out == cli("estimate", log, "-f", "csv").out


def test_an_annotated_recording_is_replaced_only_by_force(cli: Cli, log: Path, tmp_path: Path) -> None:
    output = tmp_path / "out.mcap"
    assert cli("estimate", log, "-o", output).code == 0
    topics = {info.topic: info.message_count for info in open_recording(output, load_profile()).topics()}
    assert topics["/ECM/left/image/annotations"] == topics["/ECM/left/image"]
    refused = cli("estimate", log, "-o", output)
    assert refused.code == 2
    assert "--force" in refused.err
    assert cli("estimate", log, "-o", output, "--force").code == 0
