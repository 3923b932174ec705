"""The MCAP project's conformance files read equal to their JSON.

They stand in `tests/data/mcap-conformance.tar.xz`, under the licence beside it (MIT).
"""

from __future__ import annotations

import json
import tarfile
from pathlib import Path
from typing import Any

from mcap.opcode import Opcode

from svmdist.profile import Limits
from svmdist.recording.mcap_file.container import Container
from svmdist.recording.mcap_file.content import MessageRecord
from svmdist.recording.mcap_file.record_parsers import parse
from svmdist.recording.source import Health

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


def read_as_json(path: Path) -> list[dict[str, Any]]:
    """Read a file through the hardened container, every field of every record."""
    health = Health()
    found = []
    for record in Container(path, Limits(), health).records():
        if isinstance(record, MessageRecord):
            kind = "Message"
            fields: dict[str, Any] = {
                "channel_id": record.channel_id,
                "data": bytes(record.data),
                "log_time": record.log_time_ns,
                "publish_time": record.publish_time_ns,
                "sequence": record.sequence,
            }
        else:
            body = parse(Opcode(record.opcode), record.body)
            kind, fields = type(body).__name__, vars(body)
        found.append({"type": kind, "fields": [[name, as_json(fields[name])] for name in sorted(fields)]})
    assert health.losses == ()
    return found


def test_all_files_read_equal_to_their_json(tmp_path: Path) -> None:
    with tarfile.open(ARCHIVE) as archive:
        archive.extractall(tmp_path, filter="data")
    files = sorted(tmp_path.glob("*.mcap"))
    assert len(files) == 416
    for path in files:
        assert read_as_json(path) == json.loads(path.with_suffix(".json").read_text())["records"], path.name
