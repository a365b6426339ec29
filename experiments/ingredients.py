"""Each ingredient of the default method switched off, one at a time: what it is for, and what it costs.

Question: what becomes of objective, supports, steps and time without reweighting, second order, the working set, warm starts, the
acceptance of steps, rounding or scaling, with debiasing, and from other starts?

    python experiments/ingredients.py               six minutes
    python experiments/ingredients.py --size small  some seconds

A row is one scene with one thing replaced by what `instead` says, beside the run that has it: the default, or the method with
cone steps for what only these have. `rise` is how far the objective ends above, `times` the ratio of the seconds (medians, runs
in turns), `true` what stands of the planted masts, and how far their forces are off at most. Most are switched off by values
that are public (methods, penalties, settings, starts, back-ends); where that would need a seam for this study alone, by a patch.
`asked` says that somebody called what was put in place, `changed` that the run went another way; where neither is so for an
ingredient, the exit status is 1. `planted` and `noisy` are five masts (price.py), `light` the noisy ones at a weight that fits
noise, `bumps`, `pavilion` and `terrain` what no few supports reach. Not switched off: the acceptance of cone steps, which is a
line within their loop (their damping is), and the units of the search, whose thresholds are all relative: a scene in millimetres
shows that.

Finding (two cores, rslab; ratios of times to some tens of per cent). On planted scenes, with or without noise, nothing changes
the answer, only its price. Reweighting is what finds few supports elsewhere: one group norm, rounded, ends 2 to 17 % higher
and takes 10 to 14 times as long. That its smoothing is continued gains 0.4 % on terrain, nothing elsewhere. The working set of
a model is not only faster (with all candidates 20 to 85 times as long): on bumps all candidates lead to an objective 5 %
higher. The search beats cone steps followed by its moves in time (1.2 to 5.5 times as long, 0.07 % higher on terrain); cone
steps without the moves end 2 to 6 % higher. Taking every step of the search ends 2.6 % higher on bumps, 0.1 % on terrain, and
goes round in circles to the limit of steps (seven to nine times as long). Without rounding pavilion ends 1 % higher; on the
others the support is already there and Newton's digits are missing. Second order is about digits, not values: Gauss-Newton
takes up to twice the steps, the touching parabolas up to three times, both end where the default does or 0.05 % below
(terrain). Newton's steps must be shortened only where noise is fitted: there it stops unfinished without. Shapes found each
from flat take four to thirteen times the factorisations. A warm working set saves nothing that can be measured, and the
damping of cone steps was never called for: safeguards. Scaling of cone programs changes nothing either at 625 vertices, since
Clarabel equilibrates by itself. The debiased refit moves the worst true force from 4.9 % to 3.1 % off with noise, from 0.1 %
to none without, for 0.3 and 0.02 % of objective. Starts: the target is as good as the denoised target but for terrain (0.7 %
higher); flat ends 3 % higher on pavilion, 0.5 % on terrain, and takes 78 times as long where the target is planted; heavy
weights first take 4 to 11 times as long (34 where planted) and end 0.1 % lower on terrain. On a path of six weights, afresh
alone ends up to 0.6 % higher at a weight (bumps), from the design before alone up to 6 % (pavilion); each saves a fifth to six
tenths of the time.
"""

import statistics
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from typing import Any
from unittest.mock import patch

import numpy as np
from ablation import Kind, planted, timed
from price import DATA, MASTS, NOISE, bumps
from rows import measured

import relax
from relax.convex.backends import BACKENDS, working_set
from relax.convex.subproblem import Subproblem
from relax.design.compare import penalties_for
from relax.design.methods.sequential import STEPS, Sequential
from relax.design.problem import Problem
from relax.design.rounding import round_supports
from relax.design.search import Search
from relax.design.shape import Shape, rest
from relax.iterate import iterate
from relax.sparsity.supports import sizes

Solve = Callable[[relax.Problem], relax.Design]
SIDES = {"small": 10, "full": 25}  # vertices of the planted membranes
BUMPS = {10: 11, 25: 26}  # and of bumps beside them; 26 are those of data/
ROUNDS = {"small": 1, "full": 3}
KINDS = {"planted": Kind(), "noisy": Kind(sigma=NOISE)}
LIGHT, LIGHTER = 9, 0.1  # vertices a side and share of the weight of `light`, where noise is fitted and nothing goes smoothly
FULL = ("planted", "noisy", "light", "bumps", "pavilion", "terrain")
SCENES = {"small": ("planted", "light", "bumps"), "full": FULL}
MILLI, KILO = 1e3, 1e-3  # metres in millimetres, newtons in kilonewtons
RATIO = 0.6  # of neighbouring weights on a path
PATHS = {"small": 2, "full": 6}  # weights, the last one the scene's own


# --- values that are public: other methods, penalties, settings and starts ---


def one_norm(problem: relax.Problem) -> relax.Design:
    """The group norm with one weight for good, at which a typical force costs the same; rounded under R like all others."""
    force = sizes(relax.solve(problem).forces)
    lasso = penalties_for(problem, float(np.median(force[force > 0])))["group-lasso"]
    _, rough = timed(lasso)
    last = relax.solve(problem, (rough.positions, rough.forces), method=rounding_alone)
    return together(last, rough)


def rounding_alone(problem: relax.Problem, start: Any, journal: Any) -> tuple[Shape, Shape]:
    """A method: what stands at the start, rounded."""
    return round_supports(problem, start.shape, problem.supports.always, journal).shape, start.shape


def search_alone(problem: relax.Problem, start: Any, journal: Any) -> tuple[Shape, Shape]:
    """A method: the steps of the search, and nothing after them."""
    search = Search(problem)
    shape = iterate(search, search.begin(start.shape), STEPS, journal).state.shape
    return shape, shape


def by(method: Any) -> Solve:
    """The front door with another method."""
    return lambda problem: relax.solve(problem, method=method)


def with_setting(section: str, **changes: Any) -> Solve:
    """The front door with other settings of the scene."""

    def solve(problem: relax.Problem) -> relax.Design:
        settings = dict(problem.scene.settings)
        settings[section] = {**settings[section], **changes}
        return relax.solve(problem.replace(scene=replace(problem.scene, settings=settings)))

    return solve


def from_flat(problem: relax.Problem) -> relax.Design:
    """From the membrane at rest without supports."""
    start = problem.scene.start
    return relax.solve(problem, (start, np.zeros_like(start)))


def in_millimetres(solve: Solve) -> Solve:
    """The same scene in millimetres and kilonewtons."""

    def moved(problem: relax.Problem) -> relax.Design:
        scene, penalty = problem.scene, problem.penalty
        lengths = {name: MILLI * getattr(scene, name) for name in ("target", "clean_target", "start", "rest_length")}
        spring, loads = scene.spring_constant * KILO / MILLI, KILO * scene.loads
        scene = replace(scene, **lengths, spring_constant=spring, loads=loads)
        penalty = replace(penalty, smoothing=penalty.smoothing * KILO**2)
        return solve(relax.Problem(scene, penalty, problem.strength * MILLI**2 / KILO**penalty.exponent))

    return moved


def cold(step: Subproblem, start: np.ndarray) -> Any:
    """The working set from nothing at each step."""
    del start
    return working_set(step, step.nothing)


def weights_of(problem: relax.Problem, count: int) -> list[float]:
    """Weights down to the problem's own."""
    return [problem.strength * RATIO**-step for step in range(count)][::-1]


def together(last: relax.Design, *others: relax.Design) -> relax.Design:
    """A design with the steps, factorisations and seconds of others that it took."""
    return replace(
        last,
        seconds=last.seconds + sum(other.seconds for other in others),
        iterations=last.iterations + sum(other.iterations for other in others),
        factorizations=last.factorizations + sum(other.factorizations for other in others),
    )


# --- patches: a name that is gone is an error; one that nobody asks any more ends the run with status 1 ---


def gauss_newton() -> AbstractContextManager[Any]:
    """How E_dist bends without what K changes, in the models and in Newton."""
    return patch.object(Problem, "curvature", autospec=True, side_effect=lambda problem, positions, dual: problem.metric)


def parabolas() -> AbstractContextManager[Any]:
    """The parabolas that touch R from above in place of its Hessian, in Newton: reweighted least squares to the end."""

    def touching(problem: relax.Problem, members: np.ndarray, amplitudes: np.ndarray) -> np.ndarray:
        size = sizes(amplitudes)
        bend = problem.strength * problem.supports.weights[members] * problem.penalty.slope(size)
        return np.diag(np.repeat(bend / np.where(size > 0, size, 1.0), amplitudes.shape[1]))

    return patch("relax.design.refit.penalty_hessian", autospec=True, side_effect=touching)


def all_candidates() -> AbstractContextManager[Any]:
    """Every candidate in every model."""

    def all_others(search: Search, model: Any, dual: np.ndarray, *_: Any) -> np.ndarray:
        return np.setdiff1d(np.arange(len(dual)), model.members)

    return patch.object(Search, "_newcomers", autospec=True, side_effect=all_others)


def each_from_flat() -> AbstractContextManager[Any]:
    """Each shape found from flat, in place of where the last factorisation predicts it."""

    def anew(problem: relax.Problem, guess: Shape, hopeless: Any = None) -> Shape | None:
        return rest(problem, replace(guess, positions=problem.scene.start, factor=None), hopeless)

    return patch("relax.design.shape.rest", autospec=True, side_effect=anew)


def every_step() -> AbstractContextManager[Any]:
    """What the model proposes is taken, whether or not the objective falls in truth."""
    return patch("relax.design.search.GAIN", -1e9)


def whole_steps() -> AbstractContextManager[Any]:
    """Newton's steps taken in full or not at all."""
    return patch("relax.design.refit.HALVINGS", 1)


def undamped() -> AbstractContextManager[Any]:
    """Cone steps in full or not at all."""
    return patch("relax.design.sequential._dampings", autospec=True, side_effect=lambda first: [0.0])


def unscaled() -> AbstractContextManager[Any]:
    """Cone programs handed to their solver in the units of the scene."""
    return patch.object(Subproblem, "scaled", autospec=True, side_effect=lambda step: (step, 1.0))


@dataclass(frozen=True)
class Ingredient:
    """What is switched off, what is there instead, and how: another `solve`, or `without` it; compared with `beside`."""

    name: str
    instead: str
    solve: Solve = relax.solve
    without: Callable[[], AbstractContextManager[Any]] = nullcontext
    beside: Solve = relax.solve
    scenes: tuple[str, ...] = ("planted", "noisy", "bumps", "pavilion", "terrain")
    unit: float = 1.0  # of its objective over that of `beside`


CONES = by(Sequential(working_set))
CLARABEL = by(Sequential(BACKENDS["clarabel"]))
SQUARES = ("planted", "noisy")
SOME = ("noisy", "bumps", "pavilion")

INGREDIENTS = (
    Ingredient("reweighting", "one group norm for good, rounded", one_norm),
    Ingredient("continued smoothing", "reweighting at once without", by(Sequential(continuation=relax.Continuation(3e-4)))),
    Ingredient("second order: E_dist", "Gauss-Newton", without=gauss_newton),
    Ingredient("second order: R", "touching parabolas", without=parabolas),
    Ingredient("working set of a model", "all candidates", without=all_candidates, scenes=("planted", "noisy", "bumps")),
    Ingredient("search", "cone steps, then its moves", CONES),
    Ingredient("moves after cone steps", "none", by(Sequential(working_set, moves="none")), beside=CONES),
    Ingredient("working set of cone steps", "all candidates (Clarabel)", CLARABEL, beside=CONES, scenes=SOME),
    Ingredient("warm working set", "from nothing", by(Sequential(cold)), beside=CONES, scenes=SOME),
    Ingredient("warm shapes", "each from flat", without=each_from_flat),
    Ingredient("acceptance of the search's steps", "all taken", without=every_step),
    Ingredient("shortening of Newton's steps", "in full or not at all", without=whole_steps, scenes=FULL),
    Ingredient("damping of cone steps", "in full or not at all", CONES, undamped, CONES, (*SOME, "terrain")),
    Ingredient("rounding", "the search alone", by(search_alone)),
    Ingredient("penalised refit", "debiased", with_setting("rounding", refit="debiased"), scenes=SQUARES),
    Ingredient("units", "millimetres, kilonewtons", in_millimetres(relax.solve), scenes=SQUARES, unit=MILLI**2),
    Ingredient("scaling of cone programs", "none", in_millimetres(CLARABEL), unscaled, in_millimetres(CLARABEL), SQUARES),
    Ingredient("start", "at the target", with_setting("solver", start="target")),
    Ingredient("start", "flat", from_flat),
    Ingredient("start", "flat, heavy weights first", with_setting("solver", start="heavy")),
)


def scene_of(name: str, side: int) -> relax.Problem:
    """A problem by its name."""
    if name in KINDS:
        return planted(KINDS[name], side)
    if name == "light":
        noisy = planted(KINDS["noisy"], LIGHT)
        return noisy.replace(weight=noisy.strength * LIGHTER)
    if name == "bumps":
        return bumps(BUMPS[side])
    return relax.resolve_weight(relax.Problem(relax.load_scene(DATA / f"{name}.toml")))


def row(ingredient: Ingredient, scene: str, side: int, rounds: int) -> dict[str, Any]:
    """One row: with and without take turns."""
    problem = scene_of(scene, side)
    ours: list[float] = []
    others: list[float] = []
    said, other, asked = "", None, False
    for _ in range(rounds):
        _, design = timed(problem, ingredient.beside)
        ours.append(design.seconds)
        try:
            with ingredient.without() as patched:
                _, other = timed(problem, ingredient.solve)
                asked = getattr(patched, "called", False)
        except relax.RelaxError as error:
            said = str(error)
            break
        others.append(other.seconds)
    return {
        "ingredient": ingredient.name,
        "instead": ingredient.instead,
        "scene": scene,
        "vertices": problem.scene.mesh.vertices,
        **compared(design, other, ingredient.unit),
        "true": recovered(other, side) if scene in KINDS and other else "",
        "seconds": statistics.median(ours),
        "times": statistics.median(others) / statistics.median(ours) if others else np.nan,
        "asked": asked,
        "says": said or (other.stop if other else ""),
    }


def compared(design: relax.Design, other: relax.Design | None, unit: float) -> dict[str, Any]:
    """Figures of a design, and of the other beside it; nan where there is none."""
    ours = design.certificate
    row: dict[str, Any] = {"objective": ours.objective, "rise": np.nan, "supports": ours.supports, "supports without": np.nan}
    row |= {"steps": design.iterations, "steps without": np.nan}
    row |= {"factorisations": design.factorizations, "factorisations without": np.nan}
    row |= {"stationarity": np.nan, "converged": False, "changed": True}
    if other is None:
        return row
    theirs = other.certificate
    return row | {
        "rise": theirs.objective / unit / ours.objective - 1,
        "supports without": theirs.supports,
        "steps without": other.iterations,
        "factorisations without": other.factorizations,
        "stationarity": theirs.stationarity,
        "converged": theirs.converged,
        "changed": way_of(design) != way_of(other),
    }


def way_of(design: relax.Design) -> tuple[Any, ...]:
    """What two runs that did the same have in common: their steps' objectives, to the last digit, and their factorisations."""
    return tuple(design.trace.objective), design.factorizations


def recovered(design: relax.Design, side: int) -> str:
    """How many of the planted supports stand, how many others, and how far the forces of the true ones are off at most."""
    true = np.zeros_like(design.forces)
    for x, y, force in MASTS[KINDS["noisy"].masts]:
        true[round(y * (side - 1)) * side + round(x * (side - 1))] = force
    stands, planted_at = design.forces.any(axis=1), true.any(axis=1)
    # a scene in kilonewtons: forces in the unit in which the largest is nearest
    unit = KILO if sizes(design.forces).max(initial=0.0) < sizes(true).max() * np.sqrt(KILO) else 1.0
    off = sizes(design.forces / unit - true)[stands & planted_at] / sizes(true)[stands & planted_at]
    worst = f", {off.max():.1%} off" if off.size else ""
    return f"{(stands & planted_at).sum()} of {planted_at.sum()}, {(stands & ~planted_at).sum()} others{worst}"


def path_rows(scene: str, side: int, count: int) -> list[dict[str, Any]]:
    """The path from the design before alone, and afresh alone, beside both; the worst rise of all weights."""
    problem = scene_of(scene, side)
    weights = weights_of(problem, count)
    both = list(relax.path(problem, weights))
    afresh = [relax.solve(problem.replace(weight=weight)) for weight in weights]
    warm = afresh[:1]
    for weight in weights[1:]:
        warm.append(relax.solve(problem.replace(weight=weight), (warm[-1].positions, warm[-1].forces)))
    ours = together(*reversed(both))
    rows = []
    for instead, designs in (("afresh alone", afresh), ("from the design before alone", warm)):
        worst = max(other.certificate.objective / one.certificate.objective - 1 for one, other in zip(both, designs, strict=True))
        rows.append(
            {
                "ingredient": f"warm and afresh on a path of {count}",
                "instead": instead,
                "scene": scene,
                "vertices": problem.scene.mesh.vertices,
                **compared(ours, together(*reversed(designs)), 1.0),
                "rise": worst,
                "converged": all(design.certificate.converged for design in designs),
                "true": "",
                "seconds": ours.seconds,
                "times": together(*reversed(designs)).seconds / ours.seconds,
                "asked": False,
                "says": "",
            }
        )
    return rows


def all_rows(size: str) -> list[dict[str, Any]]:
    """Every ingredient on every scene of a size that it has."""
    side, rounds = SIDES[size], ROUNDS[size]
    for solve in (relax.solve, CLARABEL):  # once before the clock: imports
        solve(scene_of("planted", side))
    rows = [
        row(ingredient, scene, side, rounds) for ingredient in INGREDIENTS for scene in SCENES[size] if scene in ingredient.scenes
    ]
    paths = [scene for scene in SOME if scene in SCENES[size]]
    return [*rows, *(each for scene in paths for each in path_rows(scene, side, PATHS[size]))]


def without_effect(rows: list[dict[str, Any]]) -> list[str]:
    """Ingredients whose absence nobody noticed: no run went another way, and nobody asked for what was put in their place."""
    named = {(row["ingredient"], row["instead"]): False for row in rows}
    for row in rows:
        named[row["ingredient"], row["instead"]] |= row["changed"] or row["asked"]
    return [f"{name}: {instead}" for (name, instead), noticed in named.items() if not noticed]


def main() -> int:
    """Measure and print."""
    rows = measured(__doc__ or "", SIDES, all_rows)
    idle = without_effect(rows)
    for name in idle:
        print(f"nobody noticed that it was switched off: {name}", file=sys.stderr)
    return 1 if idle else 0


if __name__ == "__main__":
    sys.exit(main())
