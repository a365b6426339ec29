"""The trade-off between few supports and a close fit: designs as a curve, those that no other beats, and its knee."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from relax.arrays import Floats, Ints, Mask, lock_arrays
from relax.design.optimality import EQUILIBRIUM
from relax.design.solve import Design
from relax.errors import InputError


@dataclass(frozen=True)
class TradeOff:
    """What some designs of one problem cost and how well they fit, in the order in which they came.

    Parameters
    ----------
    weight, supports, rms_distance, objective, distance, penalty, force : (D,)
        k_sparse, how many stand, metres, E_dist + R and its two terms, and the sum of force magnitudes in newtons.
    efficient : (D,) bool
        No other design has fewer supports and is as near, or is nearer with as many; of equals the first.
    knee : int
        Where the efficient curve bends most.

    Notes
    -----
    The knee is the efficient design farthest below the chord from the first to the last of them, with the number of
    supports and the logarithm of the rms distance each scaled to [0, 1] (the rule of Satopaa, Albrecht, Irwin and Raghavan,
    "Finding a 'Kneedle' in a Haystack", 2011, without its smoothing; for the corner of such curves in regularisation see
    Hansen and O'Leary, "The use of the L-curve", 1993). Where none lies below the chord each support paid as much as the one
    before, and the knee is the last. It depends on how far down the path goes: it is a proposal, not an optimum.
    """

    weight: Floats
    supports: Ints
    rms_distance: Floats
    objective: Floats
    distance: Floats
    penalty: Floats
    force: Floats
    efficient: Mask
    knee: int

    def __post_init__(self) -> None:
        lock_arrays(self)


def trade_off(designs: Sequence[Design]) -> TradeOff:
    """The curve through designs of one problem.

    Raises
    ------
    InputError
        There is none.
    """
    if not designs:
        raise InputError("trade_off: there is no design: give at least one, as relax.path makes them")
    said = [design.certificate for design in designs]
    supports = np.array([each.supports for each in said])
    rms = np.array([each.rms_distance for each in said])
    efficient = _efficient(supports, np.where(_at_rest(designs), rms, np.inf))
    return TradeOff(
        weight=np.array([design.problem.strength for design in designs]),
        supports=supports,
        rms_distance=rms,
        objective=np.array([each.objective for each in said]),
        distance=np.array([each.distance for each in said]),
        penalty=np.array([each.penalty for each in said]),
        force=np.array([float(np.linalg.norm(design.forces, axis=1).sum()) for design in designs]),
        efficient=efficient,
        knee=_knee(supports, rms, np.flatnonzero(efficient)),
    )


def _at_rest(designs: Sequence[Design]) -> Mask:
    """Whether each is a membrane that stands (D,)."""
    return np.array([each.certificate.equilibrium <= EQUILIBRIUM and each.certificate.stable for each in designs])


def _efficient(supports: Ints, rms: Floats) -> Mask:
    """Whether no other is at least as good in both and better in one; an infinite distance is none."""
    efficient = np.zeros(len(rms), dtype=bool)
    nearest = np.inf
    # lexsort is stable: of equals the first comes first
    for index in np.lexsort((rms, supports)):
        efficient[index] = rms[index] < nearest
        nearest = min(nearest, rms[index])
    if not efficient.any():
        efficient[int(np.argmin(supports))] = True
    return efficient


def _knee(supports: Ints, rms: Floats, efficient: Ints) -> int:
    order = efficient[np.argsort(supports[efficient], kind="stable")]
    if len(order) == 1:
        return int(order[0])
    count = supports[order].astype(float)
    fit = np.log(np.maximum(rms[order], np.finfo(float).tiny))
    below = 1 - (count - count[0]) / (count[-1] - count[0]) - (fit - fit[-1]) / (fit[0] - fit[-1])
    best = int(np.argmax(below))
    # round-off of a straight line is no bend
    return int(order[best if below[best] > 1e-9 else -1])


def choose(designs: Sequence[Design], count: int | None = None, rms: float | None = None) -> tuple[int, bool]:
    """Which design of a path is the answer, and whether it is what was asked for.

    With a `count` the nearest with at most so many supports; with an `rms` distance in metres the heaviest that is as near;
    else the knee. A membrane that does not stand is none. Where none is as asked, the one that comes nearest to it.
    """
    curve, at_rest = trade_off(designs), _at_rest(designs)
    if count is not None:
        fits = at_rest & (curve.supports <= count)
        near = np.where(fits, curve.rms_distance, np.inf) if fits.any() else curve.supports
        return int(np.argmin(near)), bool(fits.any())
    if rms is not None:
        fits = at_rest & (curve.rms_distance <= rms)
        best = np.argmax(np.where(fits, curve.weight, 0.0)) if fits.any() else np.argmin(curve.rms_distance)
        return int(best), bool(fits.any())
    return curve.knee, True
