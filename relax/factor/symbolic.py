"""What is done once a mesh: the choice of an engine, and its analysis of the sparsity pattern."""

from functools import cached_property
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
from scipy.sparse import csc_array

from relax.errors import InputError
from relax.factor.engine import Analysis, Engine, Numeric

# engine: the package that it needs, and where its analysis is; the fastest first (experiments/factors.py)
ENGINES = {
    "rslab": ("rslab", "relax.factor.rslab", "RslabAnalysis"),
    "pardiso": ("pymklpardiso", "relax.factor.pardiso", "PardisoAnalysis"),
    "superlu": ("scipy", "relax.factor.superlu", "SuperLUAnalysis"),
}


def available_engines() -> tuple[str, ...]:
    """Names of the engines that are installed, in the order in which "auto" takes them."""
    return tuple(name for name, (package, *_) in ENGINES.items() if find_spec(package))


def find_engine(engine: str | Engine) -> Engine:
    """The engine of that name, the first that is available for "auto", or the one that is handed in; raises InputError."""
    if callable(engine):
        return engine
    found = available_engines()
    chosen = found[0] if engine == "auto" else engine
    if chosen not in ENGINES:
        raise InputError(f"engine {engine!r} is unknown: expected auto, {', '.join(ENGINES)}")
    if chosen not in found:
        raise InputError(f"engine {engine!r} is not installed (found: {', '.join(found)}): pip install 'relax-tensile[{engine}]'")
    _, module, analysis = ENGINES[chosen]
    made: Engine = getattr(import_module(module), analysis)
    return made


class Symbolic:
    """The analysis of one sparsity pattern, made from the first matrix and shared by the factorisations of all others.

    Parameters
    ----------
    block : int
        Neighbouring unknowns that belong to one vertex and have the same neighbours.
    engine : str or Engine
        One of `available_engines()`, "auto" for the first of them, or one of your own (`relax.factor.engine`).
    """

    def __init__(self, block: int = 1, engine: str | Engine = "auto") -> None:
        self.block, self.engine = block, engine
        self._engine = find_engine(engine)
        self._pattern: csc_array | None = None

    def factorise(self, matrix: csc_array, pivot_bound: float) -> Numeric:
        """Numeric factorisation, see `relax.factor.engine.Analysis`."""
        if self._pattern is None:
            self._pattern = matrix
        elif not _same_pattern(matrix, self._pattern):
            raise ValueError("the matrix has another sparsity pattern than the one analysed: make a new Symbolic for it")
        return self._analysis.factorise(matrix, pivot_bound)

    @cached_property
    def _analysis(self) -> Analysis:
        assert self._pattern is not None
        return self._engine(self._pattern, self.block)

    def __getstate__(self) -> dict[str, Any]:
        """Without the analysis, which cannot be pickled and is made again where it is needed."""
        kept = ("block", "engine", "_engine")
        return {**{key: self.__dict__[key] for key in kept}, "_pattern": None}


def _same_pattern(one: csc_array, other: csc_array) -> bool:
    return np.array_equal(one.indptr, other.indptr) and np.array_equal(one.indices, other.indices)
