"""A YAML file of a calibration as plain values, read within limits: the file is somebody else's."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from svmdist.errors import SourceError
from svmdist.input_file import read_regular, why

MAX_BYTES = 1 << 20
OPENCV_HEADER = re.compile(r"\A%YAML:1\.0.*\n")
"""How OpenCV's FileStorage begins a file, which is no YAML directive."""


class _Loader(yaml.SafeLoader):
    """Plain values, OpenCV's matrices as mappings, and no aliases: a few of them stand for millions of values."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("an alias, which no calibration needs")
        return super().compose_node(parent, index)


def _mapping(loader: _Loader, node: yaml.Node) -> Any:
    assert isinstance(node, yaml.MappingNode)
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _mapping)


def read_yaml(path: Path) -> dict[str, Any]:
    """The first document of a YAML file, which must be a mapping; SourceError in one line for anything else."""
    try:
        data = read_regular(path, MAX_BYTES)
    except OSError as problem:
        raise SourceError(f"{path}: cannot read: {why(problem)}") from None
    try:
        text = OPENCV_HEADER.sub("", data.decode("utf-8"))
        document = next(iter(yaml.load_all(text, _Loader)), None)
    except (yaml.YAMLError, ValueError, AssertionError, RecursionError) as problem:
        raise SourceError(f"{path}: not a YAML file: {' '.join(str(problem).split())}") from None
    if not isinstance(document, dict):
        raise SourceError(
            f"{path}: expected a YAML mapping of a calibration, found {type(document).__name__}"
        )
    return {str(key): value for key, value in document.items()}
