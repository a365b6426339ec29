"""Penalties on the size t = |p_g| of a support force: profiles phi(t), t >= 0, without the weight k_sparse.

A profile has phi(0) = 0, phi' >= 0, and phi(sqrt u) concave in u. Its reweighting weight is one rule for all of them, the
largest slope from t on:

    w(t) = sup of phi'(s) over s >= t,

which is phi' itself where phi is concave. It is the slope of psi(t) = integral of w from 0 to t, concave, so each convex
step with weights w(|p|) majorises psi; and psi differs from phi by a constant once t is past the point of largest slope, so
what reweighted l1 settles on is stationary for phi too, and where nothing stands its test is the judge's own (off_support).

A new penalty is one class in a file of its own and one word in PENALTIES; `relax.check_penalty` tells whether it is right.
"""

from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any, Protocol

import numpy as np

from relax.arrays import Floats
from relax.errors import InputError
from relax.sparsity.count import Count
from relax.sparsity.folded import MCP, SCAD
from relax.sparsity.log_sum import LogSum
from relax.sparsity.parameters import parameters
from relax.sparsity.power import GroupLasso, Power

__all__ = ["MCP", "PENALTIES", "SCAD", "Count", "GroupLasso", "LogSum", "Penalty", "Power", "Proximal"]
__all__ += ["group_prox", "is_convex", "make_penalty", "steepest"]


class Penalty(Protocol):
    """A profile phi with phi(0) = 0, of force magnitudes t >= 0 in newtons; arrays in, float arrays of the same shape out.

    A profile that is flat on large forces (count, MCP, SCAD) also has `parabola(size, width)` and `smoothed(size, width)`, its
    own smoothing for reweighted least squares (relax/sparsity/surrogates.py).
    """

    @property
    def name(self) -> str:
        """As in a scene's penalty.name."""
        ...

    def value(self, size: Floats) -> Floats:
        """phi(t)."""
        ...

    def slope(self, size: Floats) -> Floats:
        """phi'(t), t > 0, and its limit at 0."""
        ...

    def curvature(self, size: Floats) -> Floats:
        """phi''(t), t > 0; at a kink of the slope the value on either side."""
        ...

    def weight(self, size: Floats) -> Floats:
        """w(t): the largest slope from t on, and so the largest of all at t = 0; infinite where phi jumps."""
        ...

    @property
    def resolution(self) -> float:
        """The size in newtons up to which a force counts as none: where phi is not yet concave; 0 for concave profiles."""
        ...


class Proximal(Penalty, Protocol):
    """A penalty that proximal methods can use; all of relax's own are."""

    def prox(self, size: Floats, step: Floats | float) -> Floats:
        """The t >= 0 of least (t - size)^2 / 2 + step phi(t), the global one for every step > 0; the smallest of equals."""
        ...


PENALTIES: dict[str, type[Any]] = {kind.name: kind for kind in (GroupLasso, Power, LogSum, MCP, SCAD, Count)}


def is_convex(penalty: Penalty) -> bool:
    """Whether one convex step is the whole penalty: its weight is the same for every force, 0 N and 1e30 N alike."""
    none, huge = penalty.weight(np.array([0.0, 1e30]))  # the format takes no larger number
    return bool(none == huge)


def steepest(penalty: Penalty) -> float:
    """The largest slope of all, w(0): what a dual must exceed for a support to enter; infinite where phi jumps at zero."""
    return float(penalty.weight(np.zeros(1))[0])


def group_prox(penalty: Penalty, vectors: Floats, step: Floats | float) -> Floats:
    """The v (m, c) of least |v - vectors|^2 / 2 + sum of step_g phi(|v_g|): each row keeps its direction and is shortened.

    Parameters
    ----------
    penalty : Penalty
        One that has a `prox`.
    vectors : (m, c)
    step : (m,) or float

    Raises
    ------
    InputError
        The penalty has no prox.
    """
    prox = getattr(penalty, "prox", None)
    if prox is None:
        raise InputError(
            f"penalty {penalty.name!r} has no prox: define prox(size, step), the t >= 0 at which (t - size)^2 / 2 + step * "
            "value(t) is least, or use a method that needs none"
        )
    size = np.hypot.reduce(np.asarray(vectors, dtype=float), axis=1)
    kept = prox(size, step) / np.where(size > 0, size, 1.0)
    return kept[:, None] * vectors


def make_penalty(settings: Mapping[str, Any]) -> Penalty:
    """The penalty of a scene's [penalty] section; keys that are absent or None take their defaults, others are ignored.

    Raises
    ------
    InputError
        No penalty has this name, or a parameter is missing or out of its range.
    """
    name = settings.get("name")
    if name not in PENALTIES:
        known = ", ".join(f'"{known}"' for known in PENALTIES)
        raise InputError(f"penalty.name is {name!r}: expected one of {known}, or hand a penalty of your own to Problem")
    kind = PENALTIES[name]
    given = {key: settings[key] for key in parameters(kind) if settings.get(key) is not None}
    for field in fields(kind):
        if field.name not in given and field.default is MISSING:
            words = parameters(kind)[field.name].words
            raise InputError(f'penalty.{field.name} is missing: penalty.name = "{name}" needs it; give {words}')
    return kind(**given)
