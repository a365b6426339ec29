"""Checks of a penalty by brute force: whether its functions say the same thing, and what the solvers rely on holds."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from relax.arrays import Floats
from relax.errors import InputError
from relax.sparsity.penalties import Penalty, is_convex, steepest
from relax.sparsity.surrogates import REWEIGHTED_L1, REWEIGHTED_L2

EXACT = 1e-12  # relative: round-off of a few operations
DIFFERENCE = 1e-4  # relative: second-order differences over steps of 1e-4 are off by 1e-8 and by the noise of values over 1e-4
STRIDE = 1e-4  # of the size: the step of a difference quotient
GRID = 1e-3  # relative: what the largest of slopes on a grid misses between its points
LEAST = 1e-4  # of the largest force: the smallest looked at


@dataclass(frozen=True)
class Check:
    """What one check found: `worst` is the largest violation, relative, infinite where a function failed; `sentence` tells it."""

    name: str
    ok: bool
    worst: float
    sentence: str


@dataclass(frozen=True)
class _Finding:
    """The largest violation, what is allowed, and what to say about it."""

    worst: float
    allowed: float
    wrong: str
    right: str


class _FaultyError(Exception):
    """A function of the penalty gave something that is no answer."""


def check_penalty(penalty: Penalty, largest: float = 1.0) -> tuple[Check, ...]:
    """Check a penalty of your own on forces up to `largest` newtons.

    Parameters
    ----------
    penalty : Penalty
        With a `prox`, that is compared with a search through a grid.
    largest : float
        Newtons; take the largest support force that is expected.

    Returns
    -------
    tuple of Check
        arrays, zero, rising, slope, curvature, weight, resolution, parabola, tangent, prox: all must be ok. A function that
        raises is a check that failed.

    Raises
    ------
    InputError
        `largest` is no number above 0.
    """
    if not 0 < largest < np.inf:
        raise InputError(f"largest is {largest}: expected a force above 0, newtons")
    sizes = _sizes(penalty, largest)
    checks: dict[str, Callable[[Any, Floats], _Finding]] = {
        "arrays": _arrays,
        "zero": _zero,
        "rising": _rising,
        "slope": _slope,
        "curvature": _curvature,
        "weight": _weight,
        "resolution": _resolution,
        "parabola": _parabola,
        "tangent": _tangent,
        "prox": _prox,
    }
    # what a function warns of shows in what it returns
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        return tuple(_checked(name, check, penalty, sizes) for name, check in checks.items())


def _checked(name: str, check: Callable[[Any, Floats], _Finding], penalty: Any, sizes: Floats) -> Check:
    try:
        found = check(penalty, sizes)
    except _FaultyError as fault:
        return Check(name, ok=False, worst=np.inf, sentence=str(fault))
    except Exception as error:  # a user's function may raise anything
        return Check(name, ok=False, worst=np.inf, sentence=f"it raised {type(error).__name__}: {error}".replace("\n", " "))
    ok = bool(found.worst <= found.allowed)
    return Check(name, ok, float(found.worst), found.right if ok else found.wrong)


def _sizes(penalty: Any, largest: float) -> Floats:
    """Forces to look at, from small to `largest`, and around the resolution where that is told."""
    sizes = np.geomspace(LEAST * largest, largest, 97)
    try:
        resolution = penalty.resolution
    except Exception:  # whatever it is, the first check says so
        resolution = None
    if isinstance(resolution, float | int | np.floating) and 0 < resolution < largest:
        sizes = np.sort(np.concatenate([sizes, float(resolution) * np.array([0.5, 0.9, 0.99, 1.01, 1.1])]))
    return sizes


def _called(penalty: Any, name: str, size: Floats) -> Floats:
    """What a function of the penalty gives, if it is an array of numbers of the right shape; a slope may be infinite at 0."""
    given = size.copy()
    found = getattr(penalty, name)(given)
    if not np.array_equal(given, size):
        raise _FaultyError(f"{name} changes the array that it is given: work on a copy")
    if not isinstance(found, np.ndarray | np.floating) or np.asarray(found).dtype.kind != "f":
        raise _FaultyError(f"{name} returns {type(found).__name__}, expected an array of floats")
    if np.shape(found) != np.shape(size):
        raise _FaultyError(f"{name} of an array of shape {np.shape(size)} has the shape {np.shape(found)}, expected the same")
    bad = np.isnan(found) | (np.isinf(found) & ((size > 0) | (name == "value")))
    if bad.any():
        first = int(np.argmax(bad))
        raise _FaultyError(f"{name}({np.ravel(size)[first]:.6g}) is {np.ravel(found)[first]}, expected a finite number")
    return np.asarray(found)


def _arrays(penalty: Any, sizes: Floats) -> _Finding:
    if not isinstance(penalty.name, str):
        raise _FaultyError(f"name is {penalty.name!r}, expected text")
    resolution = penalty.resolution
    if not isinstance(resolution, float | int | np.floating) or not 0 <= resolution < np.inf:
        raise _FaultyError(f"resolution is {resolution!r}, expected a finite number, 0 or above")
    shapes = (np.array(sizes[3]), sizes[:0], sizes, sizes[:6].reshape(2, 3))
    for name in ("value", "slope", "curvature", "weight"):
        for size in shapes:
            _called(penalty, name, size)
    for name in ("value", "slope", "weight"):
        _called(penalty, name, np.zeros(2))
    return _Finding(0.0, 0.0, "", "every function gives finite floats in the shape of its argument")


def _zero(penalty: Any, sizes: Floats) -> _Finding:
    none, top = _called(penalty, "value", np.array([0.0, sizes[-1]]))
    return _Finding(
        abs(none) / abs(top) if top else np.inf,
        EXACT,
        f"value(0) is {none:.6g} where value({sizes[-1]:.6g}) is {top:.6g}: a force of 0 costs nothing, others do",
        "a force of 0 costs nothing",
    )


def _rising(penalty: Any, sizes: Floats) -> _Finding:
    size = np.concatenate([[0.0], sizes])
    value, slope = _called(penalty, "value", size), _called(penalty, "slope", size)
    falls = np.maximum(-np.diff(value) / max(np.ptp(value), 1e-300), -slope[1:] * sizes / max(np.ptp(value), 1e-300))
    worst = int(np.argmax(falls))
    return _Finding(
        max(0.0, falls[worst]),
        EXACT,
        f"a larger force costs less near {sizes[worst]:.6g}: value must not fall, nor slope be below 0",
        "no larger force costs less",
    )


def _difference(penalty: Any, sizes: Floats, function: str, derivative: str) -> _Finding:
    """A derivative against one-sided differences: the better side, since at a kink only one is right."""
    stated = _called(penalty, derivative, sizes)
    here = _called(penalty, function, sizes)
    sides = []
    for step in (STRIDE * sizes, -STRIDE * sizes):
        one, two = _called(penalty, function, sizes + step), _called(penalty, function, sizes + 2 * step)
        sides.append((4 * one - 3 * here - two) / (2 * step))
    quotients = np.array(sides)
    # what the function itself spans there tells a derivative of 0 from noise
    span = np.abs(stated) + np.maximum(np.abs(here), np.abs(_called(penalty, "value", sizes) / sizes)) / sizes
    if function == "value":
        span = np.abs(stated) + np.abs(here) / sizes
    off = np.abs(quotients - stated) / span
    worst = int(np.argmax(off.min(axis=0)))
    quotient = quotients[int(np.argmin(off[:, worst])), worst]
    return _Finding(
        off[:, worst].min(),
        DIFFERENCE,
        f"{derivative}({sizes[worst]:.6g}) is {stated[worst]:.6g}, but {function} rises by {quotient:.6g} per newton there",
        f"{derivative} is the derivative of {function}",
    )


def _slope(penalty: Any, sizes: Floats) -> _Finding:
    return _difference(penalty, sizes, "value", "slope")


def _curvature(penalty: Any, sizes: Floats) -> _Finding:
    return _difference(penalty, sizes, "slope", "curvature")


def _jumps(penalty: Any, sizes: Floats) -> bool:
    """Whether the least force costs a good part of a large one."""
    tiny, top = _called(penalty, "value", np.array([1e-100, 1.0]) * sizes[-1])
    return bool(tiny > 1e-6 * top)


def _weight(penalty: Any, sizes: Floats) -> _Finding:
    largest = sizes[-1]
    grid = np.geomspace(1e-9 * largest, 1e9 * largest, 20_001)
    size = np.sort(np.concatenate([[0.0, penalty.resolution], grid, sizes]))
    weight, slope = _called(penalty, "weight", size), _called(penalty, "slope", size)
    from_there_on = np.maximum.accumulate(slope[::-1])[::-1]
    if _jumps(penalty, sizes):
        from_there_on[size == 0] = np.inf
    scale = from_there_on[size > 0].max() or 1.0
    off = np.where(weight == from_there_on, 0.0, np.abs(weight - from_there_on) / scale)
    worst = int(np.argmax(off))
    return _Finding(
        off[worst],
        GRID,
        f"weight({size[worst]:.6g}) is {weight[worst]:.6g}, but the largest slope from there on is {from_there_on[worst]:.6g}",
        "weight is the largest slope from each force on",
    )


def _resolution(penalty: Any, sizes: Floats) -> _Finding:
    if is_convex(penalty):
        known = penalty.resolution
        return _Finding(known / sizes[-1], 0.0, f"resolution is {known:.6g}, but phi is convex: expected 0", "phi is convex")
    known = float(penalty.resolution)
    beyond = np.concatenate([[known], sizes[sizes > known]])
    slope = _called(penalty, "slope", beyond)
    scale = 1.0 if np.isinf(steepest(penalty)) else steepest(penalty)
    rises = np.maximum(np.diff(slope), 0.0) / scale
    misses = 0.0 if (known == 0 and _jumps(penalty, sizes)) or np.isinf(slope[0]) else abs(slope[0] / scale - 1)
    worst = max(misses, rises.max(initial=0.0))
    return _Finding(
        worst,
        EXACT,
        f"phi does not turn from convex to concave at its resolution, {known:.6g}: expected the size where the slope is largest, "
        "from where on it falls; 0 where phi is concave",
        "phi is concave beyond its resolution, and not before",
    )


def _above(penalty: Any, sizes: Floats, surrogate: Any, smoothing: float) -> tuple[float, float, float]:
    """How far a surrogate falls below what it should majorise, relative to a large force's cost, and where: touching, size."""
    cost = max(float(_called(penalty, "value", sizes[-1:])[0]), 1e-300)
    size = np.concatenate([[0.0], sizes, sizes[-1] * np.array([3.0, 10.0])])
    worst = (0.0, 0.0, 0.0)
    for at in sizes[::3]:
        touching = surrogate.touching(penalty, np.full_like(size, at), size, smoothing)
        majorised = surrogate.majorised(penalty, size, smoothing)
        below = (majorised - touching) / cost
        if not np.isfinite(below).all():
            raise _FaultyError(f"the surrogate that touches at {at:.6g} is not finite: check slope and weight")
        lowest = int(np.argmax(below))
        worst = max(worst, (float(below[lowest]), float(at), float(size[lowest])))
    return worst


def _parabola(penalty: Any, sizes: Floats) -> _Finding:
    _called(penalty, "slope", sizes)
    worst = max(_above(penalty, sizes, REWEIGHTED_L2, smoothing) for smoothing in (0.0, 1e-2 * sizes[-1]))
    return _Finding(
        worst[0],
        1e-10,  # round-off of the parabola far from where it touches
        f"the parabola in |p| that touches at {worst[1]:.6g} lies below phi at {worst[2]:.6g}: slope(t) / t must not rise, "
        "else reweighted least squares does not descend",
        "the touching parabolas lie above phi",
    )


def _tangent(penalty: Any, sizes: Floats) -> _Finding:
    _called(penalty, "weight", sizes)
    worst = _above(penalty, sizes, REWEIGHTED_L1, 0.0)
    cost = float(_called(penalty, "value", sizes[-1:])[0])
    under = (_called(penalty, "value", sizes) - REWEIGHTED_L1.majorised(penalty, sizes)) / cost
    worst = max(worst, (float(under.max()), float(sizes[np.argmax(under)]), float(sizes[np.argmax(under)])))
    return _Finding(
        worst[0],
        1e-10,  # as for the parabola
        f"the tangent that touches at {worst[1]:.6g} lies below psi, the integral of weight, or psi below phi, at "
        f"{worst[2]:.6g}: weight must not rise",
        "the tangents lie above psi, and psi above phi",
    )


def _prox(penalty: Any, sizes: Floats) -> _Finding:
    if getattr(penalty, "prox", None) is None:
        return _Finding(0.0, 0.0, "", "it has none: methods that need one will say so")
    pace = sizes[-1] ** 2 / float(_called(penalty, "value", sizes[-1:])[0])
    worst = (0.0, 0.0, 0.0, 0.0)
    for share in np.geomspace(1e-6, 1e3, 28):
        step = share * pace
        found = _prox_called(penalty, sizes, step)
        for size, t in zip(sizes, found, strict=True):
            grid = size * np.concatenate([[0.0], np.geomspace(1e-6, 1.0, 200), np.linspace(0, 1, 200)])
            # the constant size^2 / 2 left out, so that small gains do not drown in it
            value = grid * (grid / 2 - size) + step * _called(penalty, "value", grid)
            mine = t * (t / 2 - size) + step * float(_called(penalty, "value", np.array([t]))[0])
            worst = max(worst, (float(mine - value.min()) / size**2, float(size), step, float(t)))
    return _Finding(
        worst[0],
        EXACT,
        f"prox({worst[1]:.6g}, {worst[2]:.6g}) is {worst[3]:.6g}, which is not where (t - size)^2 / 2 + step value(t) is least",
        "prox is nowhere beaten by a search",
    )


def _prox_called(penalty: Any, sizes: Floats, step: float) -> Floats:
    found = np.asarray(penalty.prox(sizes.copy(), step))
    if found.shape != sizes.shape or not np.isfinite(found).all():
        raise _FaultyError(f"prox of sizes of shape {sizes.shape} is no finite array of that shape at step {step:.6g}")
    if not np.array_equal(found, np.asarray(penalty.prox(sizes, np.full_like(sizes, step)))):
        raise _FaultyError(f"prox with one step for all and with as many equal steps differ at step {step:.6g}")
    if found.min() < 0:
        raise _FaultyError(f"prox is {found.min():.6g} at step {step:.6g}: expected 0 or above")
    return found
