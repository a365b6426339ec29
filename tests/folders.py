"""Scene folders on disk for the tests of reading, writing and the command line."""

from pathlib import Path

import numpy as np
import pytest

from relax.errors import InputError

SIZE = 7
LIGHT = "[penalty]\nweight = 0.02\n"


def bump(size=SIZE):
    """Heights of a smooth hill over a flat, square edge (size, size)."""
    line = np.sin(np.pi * np.linspace(0, 1, size))
    return 0.3 * np.outer(line, line) ** 2


def write_scene(folder: Path, text: str = "", name: str = "hill.toml") -> Path:
    """A scene over `bump`, with `text` behind its [target]."""
    np.save(folder / "hill.npy", bump())
    path = folder / name
    path.write_text(f'[target]\nheights = "hill.npy"\nspacing = [0.2, 0.2]\n{text}', encoding="utf-8")
    return path


def write(folder: Path, name: str, content: bytes | str) -> Path:
    """A file with `content` in `folder`."""
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def refused(read) -> str:
    """The one sentence with which `read` refuses its input."""
    with pytest.raises(InputError) as caught:
        read()
    assert "\n" not in str(caught.value)
    return str(caught.value)


def mutations(content: bytes, count: int, seed: int):
    """`content` cut short, with bytes changed, doubled and left out, `count` times."""
    rng = np.random.default_rng(seed)
    for index in range(count):
        mutant = bytearray(content)
        at = int(rng.integers(len(mutant)))
        if index % 4 == 0:
            del mutant[at:]
        elif index % 4 == 1:
            for place in rng.integers(len(mutant), size=3):
                mutant[place] = rng.integers(256)
        elif index % 4 == 2:
            del mutant[at : at + int(rng.integers(1, 9))]
        else:
            mutant[at:at] = bytes(rng.choice(list(b"0123456789-.eE \n#/nai"), size=int(rng.integers(1, 6))).tolist())
        yield bytes(mutant)
