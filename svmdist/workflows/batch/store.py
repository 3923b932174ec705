"""A folder of results: one document and one file of rows a log, each there whole or not at all."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from svmdist.errors import OutputError
from svmdist.files import remove_stale, write_atomically
from svmdist.input_file import open_regular, why
from svmdist.workflows.batch.identity import code_version, fingerprint, log_identity
from svmdist.workflows.batch.plain import from_plain, to_plain
from svmdist.workflows.batch.task import LogFile, LogJob, Outcome, Stored

SCHEMA = "svmdist.result/1"
MAX_STEM = 80
MAX_DOCUMENT_BYTES = 1 << 30


class ResultStore:
    """Where the results of a job are kept."""

    def __init__(self, folder: Path, job: LogJob[Any]) -> None:
        self.folder = folder
        self._job = job
        self._request = fingerprint([type(job).__name__, job, code_version()])
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as problem:
            raise OutputError(f"{folder}: cannot keep results there: {why(problem)}") from None
        self._remove_stale()

    def place(self, log: LogFile, identity: str) -> Path:
        """Where the document of a log's result is, whether it is there or not."""
        key = hashlib.sha256(
            "\0".join((self._request, identity, log.name)).encode("utf-8", "replace")
        ).hexdigest()
        stem = re.sub(r"[^A-Za-z0-9._-]+", "-", log.name).strip(".-")[-MAX_STEM:] or "log"
        return self.folder / f"{stem}-{key[:24]}.json"

    def place_of(self, log: LogFile) -> Path:
        """The same by the log's content as it is now; raises SvmdistError where it cannot be read."""
        return self.place(log, log_identity(log.path))

    @staticmethod
    def rows_of(place: Path) -> Path:
        """The file with the rows that belong to a document."""
        return place.with_suffix(".jsonl")

    def save(self, place: Path, stored: Stored) -> None:
        """Keep a result whose rows are written already; raises OutputError."""
        document = {
            "schema": SCHEMA,
            "request": self._request,
            "made_with": code_version(),
            "rows_sha256": _sha256(self.rows_of(place)),
            **to_plain(stored),
        }
        document["sha256"] = _checksum(document)
        write_atomically(place, [json.dumps(document, ensure_ascii=True) + "\n"])

    def load(self, place: Path, log: LogFile) -> Outcome[Any] | None:
        """Read a result; None where it is not there, or not whole, or a failure, which may have passed."""
        try:
            with open_regular(place) as file:
                document = json.loads(file.read(MAX_DOCUMENT_BYTES))
            if document.pop("sha256") != _checksum(document):
                return None
            if document.pop("schema") != SCHEMA or document.pop("request") != self._request:
                return None
            document.pop("made_with")
            if document.pop("rows_sha256") != _sha256(self.rows_of(place)):
                return None
            stored = from_plain(Stored, document)
            if stored.failure is not None:
                return None
            return self.outcome(place, log, stored)
        except (OSError, ValueError, KeyError, AttributeError, TypeError, RecursionError):
            return None

    def outcome(self, place: Path, log: LogFile, stored: Stored) -> Outcome[Any]:
        """The outcome that a document stands for; raises PlainError where its result is none of the job's."""
        result = None if stored.failure is not None else from_plain(self._job.result_type, stored.result)
        return stored.outcome(log, self.rows_of(place), result)

    def _remove_stale(self) -> None:
        """Remove what killed processes left half written."""
        remove_stale(self.folder, ".*.part")


def stored_rows(path: Path) -> Iterator[dict[str, Any]]:
    """The rows of a file, one after the other."""
    with path.open(encoding="utf-8") as file:
        for line in file:
            yield json.loads(line)


def _checksum(document: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(document, ensure_ascii=True, sort_keys=True).encode()).hexdigest()


def _sha256(path: Path) -> str:
    digest = hashlib.sha256()
    with open_regular(path) as file:
        while piece := file.read(1 << 20):
            digest.update(piece)
    return digest.hexdigest()
