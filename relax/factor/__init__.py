"""Sparse factorisation of a symmetric stiffness: one seam, several engines."""

from relax.factor.engine import Engine
from relax.factor.factor import Factor, ScalarFactor
from relax.factor.floating import FloatingFactor, Translations, translations
from relax.factor.symbolic import Symbolic, available_engines

__all__ = [
    "Engine",
    "Factor",
    "FloatingFactor",
    "ScalarFactor",
    "Symbolic",
    "Translations",
    "available_engines",
    "translations",
]
