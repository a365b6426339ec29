"""What importing relax costs, beside numpy and scipy.sparse.linalg, which it cannot do without.

Question: does `import relax` add at most 0.3 s, and `relax --help` at most 0.5 s, to importing numpy and scipy.sparse.linalg?

    python experiments/import_time.py               about a minute
    python experiments/import_time.py --size small  about ten seconds

Names of the package are imported when they are first used, so the row with `relax.solve` and `relax.load_scene` counts too.
Every run is a fresh interpreter on warm files, the commands take turns so that a busy machine slows all of them alike, and
the median of what a run adds to the bare run of its own turn counts. Exit status 1 if a limit is passed.

Finding: yes. `import relax` adds nothing that can be measured, everything that a solve needs 0.07 s, and `relax --help` is
done in 0.07 s, long before numpy would be imported: cvxpy, matplotlib and meshio wait for the commands that use them.
"""

import argparse
import statistics
import subprocess
import sys
import time

BARE = "import numpy, scipy.sparse.linalg"
COMMANDS = {
    "numpy, scipy.sparse.linalg": [sys.executable, "-c", BARE],
    "import relax": [sys.executable, "-c", f"{BARE}; import relax"],
    "import relax; relax.solve": [sys.executable, "-c", f"{BARE}; import relax; relax.solve, relax.load_scene"],
    "relax --help": [sys.executable, "-m", "relax", "--help"],
}
LIMITS = {"import relax": 0.3, "import relax; relax.solve": 0.3, "relax --help": 0.5}  # seconds
ROUNDS = {"small": 5, "full": 25}


def seconds(command: list[str]) -> float:
    """Wall time of one fresh interpreter."""
    start = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start


def main() -> int:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description="measure what importing relax costs")
    parser.add_argument("--size", choices=sorted(ROUNDS), default="full")
    rounds = ROUNDS[parser.parse_args().size]
    for command in COMMANDS.values():  # the first run reads the files from the disk
        seconds(command)
    turns = [{name: seconds(command) for name, command in COMMANDS.items()} for _ in range(rounds)]
    bare, *others = COMMANDS
    print(f"{'command':28} {'seconds':>8} {'added':>8} {'limit':>6}   ({rounds} runs each, medians)")
    print(f"{bare:28} {statistics.median(turn[bare] for turn in turns):8.3f}")
    within = True
    for name in others:
        added = statistics.median(turn[name] - turn[bare] for turn in turns)
        within &= added <= LIMITS[name]
        print(f"{name:28} {statistics.median(turn[name] for turn in turns):8.3f} {added:8.3f} {LIMITS[name]:6.1f}")
    return 0 if within else 1


if __name__ == "__main__":
    sys.exit(main())
