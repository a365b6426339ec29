"""Sweeps: one row a case, on processes of this machine (joblib) or on a cluster (Dask), into one CSV file that survives a kill.

    rows = sweep(measure, COLUMNS, cases, Path("runs.csv"), Processes(4))  # or Cluster("tcp://10.0.0.1:8786")

`measure` is a function at the top of a module: it takes one case, a flat mapping of plain values with a `seed`, and gives one
flat row with `COLUMNS`. Rows do not depend on where they were made, nor in what order; `sweep` gives them in that of the cases.

- The file (rows_file.py). The runner alone appends to it: one line a finished case, on the disk before the next is looked at; a
  lock keeps a second runner out. A killed sweep goes on where it stopped: a torn last line is cut off, cases that are there are
  skipped.
- What counts as there: a row whose `key` (a digest of the case's values) and whose versions are those of this run: Python, the
  packages, relax's files (`relax`) and the experiment's (`code`, without comments and docstrings, so that a finding can be
  written under its rows). Other rows stay in the file and are not looked at. Which `machine` made a row plays no part.
- What goes wrong. An exception is a row with the sentence in `error`; take its line out to run that case again. Where a worker
  dies, the cases that it may have had run again, each alone; one that brings down TRIES workers by itself is a row that says so.
- On a cluster, workers need what the runner has, in the same versions, or the sweep ends and says so. The experiment itself
  travels with its cases, so workers may have been started in any folder. A worker process runs one case at a time.
- BLAS is held to one thread in each worker.

Finding: killed at any moment, worker or runner, a sweep loses and repeats nothing, and its rows are the same to the last digit on
one process, on several and on a cluster (tests/test_sweeps.py kills them).
"""

import ast
import hashlib
import json
import os
import pickle
import platform
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from time import perf_counter
from typing import Any, Protocol

from rows import PACKAGES
from rows_file import RowsFile, SweepError

import relax

Case = Mapping[str, Any]
Measure = Callable[[Case], Mapping[str, Any]]
Found = dict[str, Any]
Call = Callable[[Case], Found]

TRIES = 3  # workers that one case may bring down alone: the first may have died of something else
PATIENCE = 30  # seconds until the scheduler must answer, and the first worker have come
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS", "RAYON_NUM_THREADS")


class Where(Protocol):
    """What runs cases."""

    def outcomes(self, call: Call, cases: Sequence[Case]) -> Iterator[tuple[int, Found | None]]:
        """Index of a case and its row, as they come; None where a worker may have died over it: then others may be left out."""
        ...


@dataclass(frozen=True)
class Processes:
    """Processes of this machine, by joblib; a count of 1 is this process itself, which a case that kills it takes along."""

    count: int = 1

    def outcomes(self, call: Call, cases: Sequence[Case]) -> Iterator[tuple[int, Found | None]]:
        from joblib import Parallel, delayed
        from joblib.externals.loky.process_executor import TerminatedWorkerError

        if self.count == 1:
            yield from ((index, call(case)) for index, case in enumerate(cases))
            return
        handed: set[int] = set()

        def tasks() -> Iterator[Any]:
            for index, case in enumerate(cases):
                handed.add(index)
                yield delayed(_numbered)(call, index, case)

        try:
            for index, row in Parallel(self.count, "loky", "generator_unordered", batch_size=1)(tasks()):
                handed.discard(index)
                yield index, row
        except TerminatedWorkerError:
            yield from ((index, None) for index in sorted(handed))  # joblib does not say which of them it was


@dataclass(frozen=True)
class Cluster:
    """Workers of a Dask cluster, by the address of its scheduler."""

    address: str

    def outcomes(self, call: Call, cases: Sequence[Case]) -> Iterator[tuple[int, Found | None]]:
        from concurrent.futures import CancelledError

        from dask.utils import SerializableLock
        from distributed import Client, KilledWorker, as_completed

        payload, lock = _by_value((call, versions)), SerializableLock("relax sweep")
        here = versions()

        def run(case: Case) -> tuple[Found, dict[str, str]]:  # local, so that it travels by value: no worker has this file
            with lock:  # one for all threads of a worker: figures and seconds are of a case that has the process to itself
                measured, stamp = pickle.loads(payload)
                return measured(case), stamp()

        try:
            client = Client(self.address, timeout=PATIENCE, set_as_default=False)
        except OSError as error:
            raise SweepError(f"{self.address}: no scheduler answers: start one by dask scheduler") from error
        with client:
            try:
                client.wait_for_workers(1, timeout=PATIENCE)
            except TimeoutError as error:
                raise SweepError(f"{self.address}: no worker came: start one by dask worker {self.address}") from error
            number = {future: index for index, future in enumerate(client.map(run, cases, pure=False))}
            for future in as_completed(list(number), loop=client.loop):
                index = number.pop(future)
                try:
                    row, stamp = future.result()
                except KilledWorker:
                    yield index, None  # Dask blames all that the worker had in its queue
                    continue
                except CancelledError as error:
                    raise SweepError(f"{self.address}: the scheduler is gone: start it, and give the command again") from error
                other = ", ".join(name for name, value in here.items() if stamp[name] != value)
                if other:
                    raise SweepError(f"worker {row['machine']} has another {other} than the runner: give it the same")
                yield index, row


def sweep(
    measure: Measure,
    columns: Sequence[str],
    cases: Sequence[Case],
    output: Path,
    where: Where,
    told: Callable[[int, int], None] = lambda done, of: None,
) -> list[dict[str, str]]:
    """The rows of all cases, in their order, as text; those that `output` lacks are measured and appended to it first.

    Parameters
    ----------
    measure : function of a case
    columns : names of what it gives
    cases : mappings with the same keys, `seed` among them (0: nothing is random); no two alike
    output : a CSV file, made where there is none
    where : Processes or Cluster
    told : called with the number of cases that are there, and of all

    Raises
    ------
    SweepError
        Cases that are alike or lack a seed; a file that is not of this sweep, or that another runner has; a worker with other
        versions; a cluster that is not there.
    """
    keys = [key_of(case) for case in cases]
    if not cases or len(set(keys)) < len(keys) or any("seed" not in case or set(case) != set(cases[0]) for case in cases):
        raise SweepError("cases: none, two alike, or one without the others' keys or a seed: give each the same keys, and a seed")
    stamp = {**versions(), "code": code_of(measure)}
    with RowsFile(output, ["key", *cases[0], *columns, "error", "seconds", "machine", *stamp]) as lines:
        rows = {row["key"]: row for row in lines.read() if all(row[name] == value for name, value in stamp.items())}
        rows = {key: rows[key] for key in keys if key in rows}
        left = [(key, case) for key, case in zip(keys, cases, strict=True) if key not in rows]
        told(len(rows), len(cases))
        for index, found in _outcomes(where, partial(_row, measure, tuple(columns)), [case for _, case in left]):
            key, case = left[index]
            rows[key] = lines.append({"key": key, **case, **found, **stamp})
            told(len(rows), len(cases))
    return [rows[key] for key in keys]


def _outcomes(where: Where, call: Call, cases: Sequence[Case]) -> Iterator[tuple[int, Found]]:
    """A row for every case, whatever dies on the way: each pass gives at least those that a death throws suspicion on."""
    left = list(range(len(cases)))
    while left:
        waiting, suspects = set(left), list[int]()
        for place, row in where.outcomes(call, [cases[index] for index in left]):
            waiting.discard(left[place])
            if row is None:
                suspects.append(left[place])
            else:
                yield left[place], row
        for index in suspects:
            yield index, _alone(where, call, cases[index])
        left = sorted(waiting)


def _alone(where: Where, call: Call, case: Case) -> Found:
    """The row of one case with nothing beside it, or one that says that no worker survived it."""
    for _ in range(TRIES):
        for _, row in where.outcomes(call, [case]):
            if row is not None:
                return row
    return {"error": f"{TRIES} times its worker died over this case alone: it was killed (memory?), or compiled code broke down"}


def _numbered(call: Call, index: int, case: Case) -> tuple[int, Found]:
    return index, call(case)


def _row(measure: Measure, columns: tuple[str, ...], case: Case) -> Found:
    """One case, on the worker: its figures, or what went wrong."""
    hold_threads()
    began, found, error = perf_counter(), {}, ""
    try:
        found = dict(measure(case))
    except Exception as problem:
        error = f"{type(problem).__name__}: {problem}"
    if not error and set(found) != set(columns):
        found, error = {}, f"measure gives {sorted(found)}, expected {sorted(columns)}"
    return {**found, "error": error, "seconds": perf_counter() - began, "machine": platform.node()}


def hold_threads() -> None:
    """Keep this process to one thread in what is loaded by now and in what will be."""
    import scipy.linalg  # noqa: F401 - its BLAS is not NumPy's, and a limit reaches only what is loaded
    from threadpoolctl import threadpool_limits

    os.environ.update(dict.fromkeys(THREADS, "1"))
    threadpool_limits(1)


def versions() -> dict[str, str]:
    """What figures depend on besides the experiment's own files; `relax` is a digest of its files."""
    files = sorted(Path(relax.__file__).parent.rglob("*.py"))
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()[:12]
    return {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}, "relax": digest}


def key_of(case: Case) -> str:
    """A digest of a case's values, whatever their order."""
    return hashlib.sha256(json.dumps(case, sort_keys=True, allow_nan=False).encode()).hexdigest()[:16]


def code_of(measure: Measure) -> str:
    """A digest of the file that `measure` is in and of those beside it that it imports, without comments and docstrings."""
    text = []
    for path in _files(measure):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
                del node.body[0]
        text.append(ast.dump(tree))
    return hashlib.sha256("".join(text).encode()).hexdigest()[:12]


def _files(measure: Measure) -> list[Path]:
    home = getattr(sys.modules[measure.__module__], "__file__", None)
    if home is None:
        raise SweepError("measure is in no file, so nothing tells when it changes: put it into a module and import it from there")
    found, look = set[Path](), [Path(home).resolve()]
    while look:
        path = look.pop()
        if path not in found and path.exists():
            found.add(path)
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                names = [each.name for each in node.names] if isinstance(node, ast.Import) else []
                names += [node.module] if isinstance(node, ast.ImportFrom) and node.module else []
                look += [path.parent / f"{name}.py" for name in names]
    return sorted(found)


def _by_value(sent: tuple[Any, ...]) -> bytes:
    """Functions with the files that they come from: a worker elsewhere has relax, but not the experiment."""
    import cloudpickle

    files = {Path(__file__).resolve(), *_files(versions), *_files(sent[0].args[0])}
    modules = {each for each in list(sys.modules.values()) if Path(str(getattr(each, "__file__", None))).resolve() in files}
    try:
        for module in modules:
            cloudpickle.register_pickle_by_value(module)
        return cloudpickle.dumps(sent)
    finally:
        for module in modules:
            cloudpickle.unregister_pickle_by_value(module)


def add_options(parser: ArgumentParser) -> None:
    """`--jobs` and `--scheduler`."""
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes on this machine (default 1)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="the scheduler of a Dask cluster, such as tcp://127.0.0.1:8786")


def chosen(options: Namespace) -> Where:
    """Where the command line wants cases to run."""
    return Cluster(options.scheduler) if options.scheduler else Processes(options.jobs)
