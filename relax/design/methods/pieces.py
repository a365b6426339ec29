"""A penalty's profile cut into segments, on each a convex chain of straight links that lies below it and touches it at the ends.

Minimising over which segment a force lies in, and where in it, is then a choice among few and a convex problem: what a branch
and bound needs. Segments that no minimum can lie in are left out (MATHEMATICS.md, "Other methods").
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from relax.arrays import Floats, Ints, lock_arrays
from relax.sparsity.penalties import Penalty

SHARE = 0.004  # of phi: the largest gap between it and a link; a fifth of the gaps that time leaves open
TANGENTS = 6  # of the convex part of a smoothed profile, whose value is next to nothing
GRID = 4000  # forces at which the curvature is looked at, a factor of 1.006 apart
FAR = 1e-9  # of the largest force: the smallest that is looked at


@dataclass(frozen=True)
class Pieces:
    """Segments j of the sizes t >= 0, in order, and their links in order; phi(t) >= base_j + the rise along the links.

    Parameters
    ----------
    first : (J,) int
        First link of each segment.
    base : (J,)
        The chain's value where the segment starts.
    start, end : (L,) newtons
        Of each link.
    slope : (L,)
        Of each link, rising within a segment.
    """

    first: Ints
    base: Floats
    start: Floats
    end: Floats
    slope: Floats

    def __post_init__(self) -> None:
        lock_arrays(self)

    def __len__(self) -> int:
        return len(self.base)

    @property
    def low(self) -> Floats:
        """Where each segment starts (J,), newtons."""
        return self.start[self.first]

    def value(self, size: Floats) -> Floats:
        """The chain at sizes t (k,); infinite where no segment is; where two meet, the lower."""
        at = np.asarray(size, dtype=float)[:, None]
        rise = np.add.reduceat((np.clip(at, self.start, self.end) - self.start) * self.slope, self.first, axis=1)
        high = np.maximum.reduceat(self.end, self.first)
        inside = (at >= self.low) & (at <= high)
        return np.where(inside, self.base + rise, np.inf).min(axis=1)

    def missed(self, penalty: Penalty) -> float:
        """The largest gap between phi and the chain in the middle of a link, as a share of phi there."""
        middle = 0.5 * (self.start + self.end)[self.end > self.start]
        phi = penalty.value(middle)
        return float(((phi - self.value(middle)) / phi).max(initial=0.0))

    def lowest(self, pull: Floats, bend: Floats, cost: Floats, cap: Floats) -> tuple[Floats, Floats, Floats]:
        """Least bend t^2 + cost chain(t) - pull t, t <= cap, in each segment, where, and how fast that t grows with pull (m, J).

        All four are given for each group (m,). The cap bends no segment that starts beyond it: that one must not be chosen.
        """
        pull, bend, cost = pull[:, None], bend[:, None], cost[:, None]
        end = np.maximum(np.minimum(self.end, cap[:, None]), self.start)
        wanted = (pull - cost * self.slope) / (2 * bend)
        at = np.clip(wanted, self.start, end)
        change = (at - self.start) * (bend * (at + self.start) + cost * self.slope - pull)
        low = self.low
        value = bend * low**2 + cost * self.base - pull * low + np.add.reduceat(change, self.first, axis=1)
        rate = np.add.reduceat((at == wanted) / (2 * bend), self.first, axis=1)
        return value, low + np.add.reduceat(at - self.start, self.first, axis=1), rate


def pieces_of(penalty: Penalty, largest: float, bend: float, cap: float = np.inf) -> Pieces:
    """Segments of `penalty` up to `largest` newtons.

    At a minimum the second derivative along each force is not negative, so no force has a size t < `cap` with
    phi''(t) < -`bend`, where bend is at least the curvature of E_dist along any force over what the penalty is weighed by.

    Notes
    -----
    phi is taken to be concave past its resolution and convex before it, as `Penalty` says.
    """
    if penalty.value(np.array([np.finfo(float).tiny]))[0] > 0:  # it jumps at zero: counted
        jump = penalty.value(np.array([np.finfo(float).tiny]))
        rest = _secants(penalty, np.finfo(float).tiny, largest)
        return _joined([[(0.0, 0.0, 0.0, 0.0)], [(0.0, rest[0][0][1], float(jump[0]), rest[0][0][3])], *rest[1:]])
    left, right = _forbidden(penalty, largest, bend)
    right = min(right, cap)
    if penalty.resolution > 0:
        left, right = (left, right) if right > left else (penalty.resolution, penalty.resolution)
        return _joined([_tangents(penalty, min(left, largest)), *(_secants(penalty, right, largest) if right < largest else [])])
    if right <= left:
        return _joined(_secants(penalty, 0.0, largest))
    small = _secants(penalty, 0.0, left) if left > 0 else [[(0.0, 0.0, 0.0, 0.0)]]
    return _joined([*small, *_secants(penalty, min(right, largest), largest)])


_Link = tuple[float, float, float, float]  # start, end, value at the start, slope


def _joined(segments: list[list[_Link]]) -> Pieces:
    count = np.array([len(links) for links in segments])
    start, end, value, slope = np.array([link for links in segments for link in links]).T
    first = np.concatenate([[0], np.cumsum(count)[:-1]])
    return Pieces(first, value[first], start, end, slope)


def _at(penalty: Penalty, size: float) -> float:
    return float(penalty.value(np.array([size]))[0])


def _forbidden(penalty: Penalty, largest: float, bend: float) -> tuple[float, float]:
    """The first interval of sizes, between points of a grid that are all in it, that no minimum has; empty: two equal numbers."""
    grid = np.geomspace(max(penalty.resolution, FAR * largest), largest, GRID)
    out = penalty.curvature(grid) < -bend
    if not out.any():
        return 0.0, 0.0
    begin = int(np.argmax(out))
    length = int(np.argmin(out[begin:])) or len(out) - begin
    return (0.0 if begin == 0 else float(grid[begin])), float(grid[begin + length - 1])


def _secants(penalty: Penalty, low: float, high: float) -> list[list[_Link]]:
    """Segments of a concave stretch, a link each, halved until phi leaves the link by no more than its share."""
    if high <= low:
        return [[(low, low, _at(penalty, low), 0.0)]]
    middle = 0.5 * (low + high) if low < FAR * high else float(np.sqrt(low * high))
    below, above = _at(penalty, low), _at(penalty, high)
    slope = (above - below) / (high - low)
    gap = _at(penalty, middle) - below - slope * (middle - low)
    if gap <= SHARE * _at(penalty, middle) or high < FAR * penalty.resolution:
        return [[(low, high, below, slope)]]
    return [*_secants(penalty, low, middle), *_secants(penalty, middle, high)]


def _tangents(penalty: Penalty, high: float) -> list[_Link]:
    """One segment from 0: tangents of the convex part, then the line that touches it and meets phi at `high`."""

    def slope(t: float) -> float:
        return float(penalty.slope(np.array([t]))[0])

    def missed(t: float) -> float:
        return _at(penalty, t) + slope(t) * (high - t) - _at(penalty, high)

    turn = min(penalty.resolution, high)
    touch = float(brentq(missed, 0.0, turn)) if missed(turn) > 0 else turn
    points = np.linspace(0.0, touch, TANGENTS)
    slopes = np.array([slope(t) for t in points])
    offsets = np.array([_at(penalty, t) for t in points]) - slopes * points
    corners = np.concatenate([[0.0], -np.diff(offsets) / np.diff(slopes), [high]])
    values = np.concatenate([offsets[:1], offsets + slopes * corners[1:]])
    return [
        (float(a), float(b), float(v), float(k)) for a, b, v, k in zip(corners[:-1], corners[1:], values, slopes, strict=False)
    ]
