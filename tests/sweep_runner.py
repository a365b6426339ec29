"""A sweep to be killed: some cases that work, some that raise or bring down their worker; run as a script by test_sweeps.py."""

import argparse
import os
import signal
import sys
import time
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_info

sys.path.insert(0, str(Path(__file__).parent.parent / "experiments"))
from sweeps import add_options, chosen, sweep

COLUMNS = ("value", "threads", "process")


def measure(case):
    """A figure that every digit of a solve with a random matrix goes into."""
    once = Path(case["folder"]) / f"{case['seed']} was here"
    if case["does"] == "raise":
        raise ArithmeticError("no figure\nfor this one")
    if case["does"] == "die" or (case["does"] == "die once" and not once.exists()):
        once.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(case["seconds"])
    matrix = np.random.default_rng(case["seed"]).normal(size=(60, 60))
    threads = max(each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas")
    return {"value": np.linalg.solve(matrix, matrix[0]).sum(), "threads": threads, "process": os.getpid()}


def cases(folder, count=12, seconds=0.0, **does):
    """`count` cases; does: what those named `case<seed>` do instead of working."""
    shared = {"seconds": seconds, "folder": str(folder)}
    return [{"seed": seed, "does": does.get(f"case{seed}", "work"), **shared} for seed in range(count)]


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("output", type=Path)
    parser.add_argument("--seconds", type=float, default=0.0)
    parser.add_argument("--does", nargs=2, action="append", default=[])
    add_options(parser)
    options = parser.parse_args()
    asked = cases(options.output.parent, seconds=options.seconds, **dict(options.does))
    sweep(measure, COLUMNS, asked, options.output, chosen(options))
