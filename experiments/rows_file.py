"""The file of a sweep: CSV, one writer at a time, whole to its last line, rows only ever added."""

import csv
import fcntl
import io
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np


class SweepError(Exception):
    """A sweep cannot go on; the message says why, and what to do."""


class RowsFile:
    """A context: locked on entry; `read` once, then `append`.

    Raises
    ------
    SweepError
        Another process holds the lock.
    """

    def __init__(self, path: Path, header: list[str]) -> None:
        self.path, self.header = path, header

    def __enter__(self) -> Self:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.handle = self.path.open("a+b", buffering=0)
        try:
            fcntl.flock(self.handle, fcntl.LOCK_EX | fcntl.LOCK_NB)  # the system lets go of it when the process dies
        except BlockingIOError as error:
            self.handle.close()
            raise SweepError(f"{self.path}: another sweep is writing it: wait for its end, or name another file") from error
        return self

    def __exit__(self, *_: object) -> None:
        self.handle.close()

    def read(self) -> list[dict[str, str]]:
        """All whole rows; what a kill left of a line is cut off, and a new file gets its header.

        Raises
        ------
        SweepError
            Another header than ours, or a line with too few or too many fields.
        """
        self.handle.seek(0)
        text = self.handle.read()
        whole = text.rfind(b"\n") + 1
        self.handle.truncate(whole)
        first, *lines = list(csv.reader(text[:whole].decode().splitlines())) or [[]]
        if not first:
            self._write(self.header)
        elif first != self.header:
            raise SweepError(f"{self.path}: its columns are not those of this sweep: name another file")
        for number, line in enumerate(lines, 2):
            if len(line) != len(first):
                raise SweepError(f"{self.path}: line {number} has {len(line)} fields, expected {len(first)}: take it out")
        return [dict(zip(first, line, strict=True)) for line in lines]

    def append(self, row: Mapping[str, Any]) -> dict[str, str]:
        """Write one row, on the disk on return; gives it as it will be read."""
        texts = [as_text(row.get(name)) for name in self.header]
        self._write(texts)
        return dict(zip(self.header, texts, strict=True))

    def _write(self, texts: Sequence[str]) -> None:
        line = io.StringIO()
        csv.writer(line, lineterminator="\n").writerow(texts)
        self.handle.write(line.getvalue().encode())
        os.fsync(self.handle.fileno())


def as_text(value: Any) -> str:
    """A value as the file has it: floats with all their digits, text on one line, nothing for None."""
    plain = value.item() if isinstance(value, np.generic) else value
    return "" if plain is None else " ".join(plain.split()) if isinstance(plain, str) else repr(plain)
