"""The MCAP project's conformance files read equal to their JSON.

They stand in `tests/data/mcap-conformance.tar.xz`, under the licence beside it (MIT).
"""

import json
from pathlib import Path
from typing import Any

from svmdist.profile import Limits
from svmdist.recording.mcap import McapSource, _Pass
from tests.conftest import unpack

ARCHIVE = Path(__file__).parents[1] / "data" / "mcap-conformance.tar.xz"


def as_json(value: Any) -> Any:
    """Write a field as the conformance files do: numbers and bytes as decimal text, maps with text keys."""
    match value:
        case bytes():
            return [str(byte) for byte in value]
        case int():
            return str(value)
        case dict():
            return {str(key): as_json(item) for key, item in value.items()}
        case _:
            return value


def test_all_files_read_equal_to_their_json(tmp_path):
    """Every field of every record."""
    unpack(ARCHIVE, tmp_path)
    files = sorted(tmp_path.glob("*.mcap"))
    assert len(files) == 416
    for path in files:
        source, found = McapSource(path, Limits()), []
        for _, record in _Pass(source).records(None):
            fields = sorted(vars(record).items())
            found.append({"type": type(record).__name__, "fields": [[name, as_json(value)] for name, value in fields]})
        assert source.health.losses == ()
        assert found == json.loads(path.with_suffix(".json").read_text())["records"], path.name
