"""Spring laws: what an edge of length l, rest length L and constant k stores, pulls and resists.

A law is four functions of the length alone, so a new one is one small class; `taylor_slope` in the tests checks that each
is the derivative of the one before.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from relax.arrays import Floats


class Springs(Protocol):
    """A spring law: energy e(l) and its first three derivatives, each (E,) from lengths, rest lengths and constants."""

    @property
    def name(self) -> str:
        """As in a scene's membrane.springs."""
        ...

    def energy(self, length: Floats, rest: Floats, constant: Floats) -> Floats:
        """Stored energy e, newton metres."""
        ...

    def tension(self, length: Floats, rest: Floats, constant: Floats) -> Floats:
        """Pull e', newtons; negative where the edge pushes."""
        ...

    def stiffness(self, length: Floats, rest: Floats, constant: Floats) -> Floats:
        """Axial stiffness e'', newtons per metre."""
        ...

    def stiffness_slope(self, length: Floats, rest: Floats, constant: Floats) -> Floats:
        """e''', newtons per square metre; 0 for piecewise quadratic energies."""
        ...


@dataclass(frozen=True)
class Hookean:
    """The paper's spring, e = k/2 (l - L)^2: it also pushes when shorter than its rest length."""

    name: str = "hookean"

    def energy(self, length: Floats, rest: Floats, constant: Floats) -> Floats:
        return 0.5 * constant * (length - rest) ** 2

    def tension(self, length: Floats, rest: Floats, constant: Floats) -> Floats:
        return constant * (length - rest)

    def stiffness(self, length: Floats, rest: Floats, constant: Floats) -> Floats:
        return constant + 0.0 * length

    def stiffness_slope(self, length: Floats, rest: Floats, constant: Floats) -> Floats:
        return np.zeros_like(length)


@dataclass(frozen=True)
class TensionOnly:
    """A Hookean spring that goes slack below its rest length, as cables and fabric do."""

    name: str = "tension-only"

    def energy(self, length: Floats, rest: Floats, constant: Floats) -> Floats:
        return 0.5 * constant * np.maximum(length - rest, 0.0) ** 2

    def tension(self, length: Floats, rest: Floats, constant: Floats) -> Floats:
        return constant * np.maximum(length - rest, 0.0)

    def stiffness(self, length: Floats, rest: Floats, constant: Floats) -> Floats:
        return np.where(length > rest, constant, 0.0)

    def stiffness_slope(self, length: Floats, rest: Floats, constant: Floats) -> Floats:
        return np.zeros_like(length)


@dataclass(frozen=True)
class ForceDensity:
    """An edge of constant force density q = tension / length (Linkwitz and Schek): e = q/2 l^2, equilibrium is linear."""

    name: str = "force-density"

    def energy(self, length: Floats, rest: Floats, constant: Floats) -> Floats:
        return 0.5 * constant * length**2

    def tension(self, length: Floats, rest: Floats, constant: Floats) -> Floats:
        return constant * length

    def stiffness(self, length: Floats, rest: Floats, constant: Floats) -> Floats:
        return constant + 0.0 * length

    def stiffness_slope(self, length: Floats, rest: Floats, constant: Floats) -> Floats:
        return np.zeros_like(length)


SPRINGS: dict[str, Springs] = {law.name: law for law in (Hookean(), TensionOnly(), ForceDensity())}
