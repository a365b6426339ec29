"""Sparse factorisation of a symmetric stiffness: one seam, several engines."""

from relax.factor.engine import Engine
from relax.factor.factor import Factor, ScalarFactor
from relax.factor.symbolic import Symbolic, available_engines

__all__ = ["Engine", "Factor", "ScalarFactor", "Symbolic", "available_engines"]
