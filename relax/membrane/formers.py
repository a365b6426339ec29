"""The ways of form-finding by name, and the one that takes over when Newton is lost."""

from dataclasses import replace
from typing import Protocol

from relax.arrays import Floats
from relax.iterate import Stop
from relax.membrane.dynamic_relaxation import relax_dynamically
from relax.membrane.equilibrium import LARGEST_LIMIT, find_equilibrium, with_last_digits
from relax.membrane.force_density import find_by_force_density
from relax.membrane.membrane import Membrane
from relax.membrane.rest import Balance, Equilibrium

NEAR = 1e-6  # relative residual from which Newton finds the rest of the way in a few steps
RESCUE_LIMIT = 20_000  # explicit steps to there: several times what a membrane that finds rest was seen to need
WAYLAID = (Stop.SLACK, Stop.MECHANISM, Stop.LIMIT)  # Newton's stops that say nothing against an equilibrium


class Former(Protocol):
    """A way of form-finding."""

    def __call__(self, membrane: Membrane, positions: Floats, applied: Floats, limit: int | None = None) -> Equilibrium:
        """From start positions (V, 3) metres to rest under applied forces (n, 3) newtons, in at most `limit` iterations."""
        ...


def form_find(membrane: Membrane, positions: Floats, applied: Floats, limit: int | None = None) -> Equilibrium:
    """Bring the membrane to rest by Newton; where it is lost, by dynamic relaxation from the start, and Newton again.

    Parameters
    ----------
    membrane : Membrane
    positions : (V, 3) metres
        Where to start; fixed vertices stay there.
    applied : (n, 3) newtons
        Loads and support forces on the free vertices.
    limit : int, optional
        Largest number of Newton and chord steps, each time; default 200.

    Returns
    -------
    Equilibrium
        `ran` says which methods it took; iterations and factorizations are their sums. Where none finds rest, `stop` is what
        Newton said first.
    """
    limit = LARGEST_LIMIT if limit is None else limit
    first = find_equilibrium(membrane, positions, applied, limit=limit)
    if first.found or first.stop not in WAYLAID:
        return _to_the_end(membrane, first, applied)
    rough = relax_dynamically(membrane, positions, applied, RESCUE_LIMIT, NEAR)
    ran = [first, rough]
    if NEAR >= rough.residual > 0:
        ran.append(find_equilibrium(membrane, rough.positions, applied, limit=limit))
        if not ran[-1].found:
            ran.append(relax_dynamically(membrane, rough.positions, applied, RESCUE_LIMIT))
    best = _to_the_end(membrane, min(ran, key=lambda one: one.residual), applied)
    return replace(
        best,
        stop=best.stop if best.found else first.stop,
        iterations=sum(one.iterations for one in ran),
        factorizations=sum(one.factorizations for one in ran),
        ran=tuple(name for one in ran for name in one.ran),
    )


def _to_the_end(membrane: Membrane, found: Equilibrium, applied: Floats) -> Equilibrium:
    """The same shape to the last digits, where there is a factorisation for it."""
    if not found.found or found.factor is None or found.factor.singular:
        return found
    positions = with_last_digits(membrane, found.positions, applied, found.factor)
    return replace(found, positions=positions, residual=Balance(membrane, applied, positions).measure(positions)[1])


FORMERS: dict[str, Former] = {
    "newton": form_find,
    "dynamic-relaxation": relax_dynamically,
    "force-density": find_by_force_density,
}
