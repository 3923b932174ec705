"""The writer: byte-identical, never replacing, readable when interrupted, honest about a full disk."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from svmdist.errors import UsageError
from svmdist.recording.log import open_recording
from svmdist.samples import ImageSample
from tests.reading import read_images
from tests.synthetic import write_samples

from .builders import Entry, scene, write_scene

FILL_A_DISK = """
import resource, sys
from pathlib import Path
from svmdist.errors import OutputError
from tests.recording.builders import scene, write_scene
entries = scene(40)
for limit in map(int, sys.argv[2:]):
    path = Path(sys.argv[1]) / f"{limit}.mcap"
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
    try:
        write_scene(path, entries)
    except OutputError as problem:
        assert "cannot write" in str(problem) and "\\n" not in str(problem), problem
        assert not path.exists()
        assert not path.with_name(path.name + ".part").exists()
        print("refused")
    else:
        print("written")
"""


def test_chunks_hold_at_most_256_kib(tmp_path):
    rng = np.random.default_rng(0)
    images = (rng.integers(0, 256, (120, 160, 3), np.uint8) for _ in range(40))
    frames = (ImageSample(number * 1_000_000, "camera", image) for number, image in enumerate(images))
    path = write_samples(tmp_path / "large.mcap", (("/image", frame) for frame in frames))
    with path.open("rb") as stream:
        summary = make_reader(stream, validate_crcs=True).get_summary()
    assert len(summary.chunk_indexes) > 5
    assert max(index.uncompressed_size for index in summary.chunk_indexes) <= 256 * 1024


def test_a_rerun_is_byte_identical_and_log_times_are_the_stamps(tmp_path, native, entries):
    assert write_scene(tmp_path / "again.mcap", entries).read_bytes() == native.read_bytes()
    with native.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        found = [
            (channel.topic, message.log_time, message.publish_time)
            for _, channel, message in reader.iter_messages(log_time_order=False)
        ]
        assert reader.get_header().library.startswith("svmdist ")
    assert found == [(e.topic, e.sample.stamp_ns, e.sample.stamp_ns) for e in entries]


def test_an_interrupted_recording_keeps_its_part(tmp_path, profile):
    path = tmp_path / "a.mcap"

    def interrupted() -> Iterator[Entry]:
        yield from scene(4)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_samples(path, interrupted(), {"seed": "1"})
    assert not path.exists()
    part = open_recording(tmp_path / "a.mcap.part", profile)
    assert len(list(read_images(part))) == 4
    assert part.metadata == {"seed": "1"}
    assert "truncated" in part.health.describe()[0]
    with pytest.raises(UsageError, match="interrupted"):
        write_scene(path, scene(1))


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs RLIMIT_FSIZE")
def test_a_full_disk_leaves_no_file_under_the_final_name(tmp_path):
    full_bytes = write_scene(tmp_path / "full.mcap", scene(40)).stat().st_size
    limits = [full_bytes * step // 50 for step in range(50)]
    command = [sys.executable, "-c", FILL_A_DISK, tmp_path, *map(str, [*limits, full_bytes])]
    root = Path(__file__).parents[2]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    assert done.stderr == ""
    assert done.stdout.split() == ["refused"] * 50 + ["written"]
