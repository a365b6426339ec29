"""Solutions of lesson 5."""

import marimo

__generated_with = "0.25.2"
app = marimo.App(app_title="5. Solutions")

with app.setup:
    import sys
    from pathlib import Path
    from runpy import run_path
    from types import SimpleNamespace

    import marimo as mo
    import numpy as np
    from scipy.stats import binomtest

    LESSONS = Path(__file__).resolve().parents[1]
    sys.path.insert(0, str(LESSONS))
    # its functions; its cells do not run
    lesson = SimpleNamespace(**run_path(str(LESSONS / "5_rounding.py")))


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    # 5. Solutions

    ## 1. Thirty of thirty

    With success rate s that happens with probability $s^{30}$. It is below 5 % for $s < 0.05^{1/30} = 0.905$: "always right"
    after 30 draws means "at least 90 %", and about $1 - 3/n$ in general.
    """)
    return


@app.cell
def _():
    _bound = 0.05 ** (1 / 30)
    assert np.isclose(_bound, binomtest(30, 30, alternative="greater").proportion_ci(0.95, "exact").low)
    assert abs(_bound - (1 - 3 / 30)) < 0.01
    return


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## 2. Neighbours

    For each mast and each vertex that shares an edge with it: move it there with its force, settle, compare.
    """)
    return


@app.cell
def _():
    net = lesson.three_masts(lesson.SIGMA)
    design = lesson.relax.solve(net.problem(lesson.PENALTY, lesson.STRENGTH))
    _forces = design.forces[net.free]
    _stands = np.flatnonzero(lesson.sizes(_forces))
    _tried = 0
    for _place in _stands:
        _edges = net.mesh.edges[(net.mesh.edges == net.free[_place]).any(axis=1)]
        for _other in np.flatnonzero(np.isin(net.free, _edges) & (net.free != net.free[_place])):
            _moved = _forces.copy()
            _moved[_other], _moved[_place] = _forces[_place], 0
            _settled = lesson.settle(net, _moved, np.flatnonzero(lesson.sizes(_moved)))
            assert lesson.objective(net, _settled) > lesson.objective(net, _forces)
            _tried += 1
    assert _tried == 11  # four neighbours each, one of which is fixed
    mo.md(f"{_tried} moves, none pays")
    return design, net


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## 3. The last price

    A mast pays as long as what the fit loses without it is more than its price, both with the others settled. `explain` gives
    $E$ lost without it at the present $k$; at first sight the mast goes when $k\varphi(|p|)$ reaches that. Bisect for the
    truth: it is somewhat higher. A heavier price shrinks the force, so $\varphi(|p|)$ falls, and without the mast the two
    others grow, so less than its price is saved. What it does for the fit falls too, but by less.
    """)
    return


@app.cell
def _(design, net):
    _places = [np.flatnonzero(np.isin(net.free, some)) for some in ((45, 109, 115), (45, 109))]

    def _pays(strength):
        """Whether three masts, settled, stand and are lower than two."""
        three, two = (lesson.settle(net, design.forces[net.free], places, strength) for places in _places)
        stands = lesson.sizes(three)[_places[0]].min() > lesson.PENALTY.resolution
        return stands and lesson.objective(net, three, strength) < lesson.objective(net, two, strength)

    _low, _high = 0.05, 0.5
    assert _pays(_low) and not _pays(_high)
    for _ in range(30):
        _middle = (_low + _high) / 2
        _low, _high = (_middle, _high) if _pays(_middle) else (_low, _middle)
    _worth = lesson.relax.explain(net.problem(lesson.PENALTY, lesson.STRENGTH), design.positions, design.forces).supports[2]
    _guess = _worth.loss_distance / _worth.price * lesson.STRENGTH
    assert _guess < _low < 1.25 * _guess
    _solved = [lesson.relax.solve(net.problem(lesson.PENALTY, share * _low)).certificate.supports for share in (0.97, 1.03)]
    assert _solved == [3, 2]
    mo.md(f"the mast goes at k = {_low:.4f}; from `explain` one would guess {_guess:.4f}")
    return


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## 4. Threshold

    A thousandth of the largest is 0.0003 N. Here nothing but the masts is above it, so the rule works; but it does not know
    the smoothing. With $\varepsilon$ a hundred times larger the small forces grow past it, and masts that are none are kept,
    while $t_1$ grows along.
    """)
    return


@app.cell
def _(net):
    _everywhere = np.arange(len(net.free))
    _kept = {}
    for _smoothing in (1e-6, 1e-4):
        _penalty = lesson.relax.Power(exponent=0.5, smoothing=_smoothing)
        _size = lesson.sizes(lesson.settle(net, -net.stiffness @ net.offset, _everywhere, lesson.STRENGTH, _penalty))
        _kept[_smoothing] = int((_size > 1e-3 * _size.max()).sum()), int((_size > _penalty.resolution).sum())
    assert _kept[1e-6] == (3, 3) and _kept[1e-4][0] > 10 and _kept[1e-4][1] == 3
    mo.md(f"kept by the threshold and by t1: {_kept[1e-6]}, with a hundred times the smoothing {_kept[1e-4]}")
    return


if __name__ == "__main__":
    app.run()
