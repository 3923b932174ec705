"""Mutants of what every parser takes: a value, or an error of its own; no other exception, and no endless work.

A corpus of small inputs stands in `tests/data/corpus`, a folder a parser; `tests/fuzz.py` looks for more that reach new
code, by coverage. `pytest -m fault` makes 25,000 mutants of them, the plain run a few hundred.
"""

import random
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from svmdist.errors import ProfileError, SvmdistError
from svmdist.geometry import read_closed_mesh
from svmdist.profile import Limits, load_profile
from svmdist.recording.images import ImageError, decode_still
from svmdist.recording.log import open_recording
from svmdist.recording.messages import SCHEMAS, DecodeError, Decoder
from svmdist.recording.source import RawMessage
from svmdist.recording.summary import inspect_recording

from .faults import mutate_body

CORPUS = Path(__file__).parents[1] / "data" / "corpus"
LIMITS = Limits()
MAX_SECONDS = 10.0
"""Of processor, for one mutant."""


def log(data: bytes, folder: Path) -> None:
    """A whole file, of whatever kind it says that it is: MCAP, ROS 1, SQLite."""
    path = folder / "mutant"
    path.write_bytes(data)
    with suppress(SvmdistError):
        inspect_recording(open_recording(path, load_profile()))


def far(data: bytes, _: Path) -> None:
    """MCAP behind a URL, read by its index where it has one."""
    import fsspec

    fsspec.filesystem("memory").pipe_file("/mutant.mcap", data)
    with suppress(SvmdistError):
        recording = open_recording("memory://mutant.mcap", load_profile())
        for _ in recording.file.source.messages():
            pass
        assert isinstance(recording.metadata, dict)


def toml(data: bytes, folder: Path) -> None:
    """A profile; NumPy may not warn of its numbers either."""
    path = folder / "mutant.toml"
    path.write_bytes(data)
    with suppress(ProfileError):
        loaded = load_profile(path)
        if loaded.tissue is not None:
            np.linalg.inv(loaded.tissue.T_tissue_mesh)


def image(data: bytes, _: Path) -> None:
    """A compressed image."""
    with suppress(ImageError):
        decoded = decode_still(data, LIMITS)
        assert (decoded.dtype, decoded.ndim) == (np.uint8, 3)


def mesh(data: bytes, folder: Path) -> None:
    """A mesh, in either format."""
    for ending in (".obj", ".stl"):
        path = folder / f"mutant{ending}"
        path.write_bytes(data)
        read_closed_mesh.cache_clear()
        with suppress(ProfileError):
            read_closed_mesh(path, 1e-3)


def message(encoding: str) -> Callable[[bytes, Path], None]:
    """A message of an encoding, taken for each schema that it may have."""

    def decode(data: bytes, _: Path) -> None:
        for schema in SCHEMAS[encoding]:
            raw = RawMessage("/t", schema, encoding, 1, data)
            with suppress(DecodeError):
                Decoder(LIMITS).decode(raw)
            with suppress(ImageError):
                Decoder(LIMITS).image(raw).decode()

    return decode


TARGETS: dict[str, Callable[[bytes, Path], None]] = {
    "mcap": log,
    "far": far,
    "bag1": log,
    "sqlite": log,
    "profile": toml,
    "toml": toml,
    "mesh": mesh,
    "image": image,
    "protobuf": message("protobuf"),
    "cdr": message("cdr"),
    "ros1": message("ros1"),
}
SHARES = {"mcap": 3000, "bag1": 2000, "sqlite": 1500, "profile": 500}
"""Mutants in the long run; of the others 2,000: 25,000 in all."""


def mutants(seeds: list[bytes], count: int, seed: int) -> list[bytes]:
    """Mutants of a corpus, and pieces of two of its inputs put together."""
    rng = random.Random(seed)
    found = []
    for _ in range(count):
        data = rng.choice(seeds)
        for _ in range(rng.choice((1, 1, 2, 4))):
            start = rng.randrange(len(data) + 1)
            end = min(len(data), start + rng.choice((8, 64, 512, 4096)))
            data = data[:start] + mutate_body(data[start:end], rng) + data[end:]
        if rng.random() < 0.1:
            other = rng.choice(seeds)
            data = data[: rng.randrange(len(data) + 1)] + other[rng.randrange(len(other) + 1) :]
        found.append(data)
    return found


def check(target: str, data: bytes, folder: Path) -> None:
    """Whatever is raised, or takes too long, names the input."""
    started = time.process_time()
    try:
        TARGETS[target](data, folder)
    except Exception as problem:
        problem.add_note(f"{target} of {len(data)} bytes: {data[:400]!r}")
        raise
    assert time.process_time() - started < MAX_SECONDS, data[:400]


def corpus_of(target: str) -> list[bytes]:
    """The inputs of a target; small ones first."""
    folder = CORPUS / ("mcap" if target == "far" else target)
    found = sorted(folder.iterdir(), key=lambda path: (path.stat().st_size, path.name))
    assert found, f"no corpus for {target}"
    return [path.read_bytes() for path in found]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("is_long", [False, pytest.param(True, marks=pytest.mark.fault)], ids=["short", "long"])
@pytest.mark.parametrize("target", TARGETS)
def test_mutants_give_a_value_or_an_error_of_ours(tmp_path, target, is_long):
    seeds = corpus_of(target)
    for data in seeds:
        check(target, data, tmp_path)
    count = SHARES.get(target, 2000) if is_long else 30
    for data in mutants(seeds, count, seed=11 if is_long else 10):
        check(target, data, tmp_path)
