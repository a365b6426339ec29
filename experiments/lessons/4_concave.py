"""Lesson 4: from l1 to l2^alpha, majorise-minimise by hand."""

import marimo

__generated_with = "0.25.2"
app = marimo.App(app_title="4. From l1 to l2^alpha")

with app.setup:
    import time
    from dataclasses import replace
    from itertools import pairwise

    import marimo as mo
    import numpy as np
    from drawing import BLACK, BLUE, COLOURS, GREEN, ORANGE, label, new_figure, quick_picture, table
    from nets import Net, sizes, three_masts

    import relax
    from relax.convex.backends import working_set

    # alpha; k_sparse, m^2 / N^alpha; eps, N^2
    ALPHA, STRENGTH, EPS = 0.5, 0.05, 1e-6
    # of a force of 0.25 N, m^2
    PRICES = [0.01, 0.02, 0.03, 0.05, 0.1, 0.2, 0.3, 0.5]


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    # 4. From l1 to l2^alpha: majorise-minimise by hand

    **Goals.** After this lesson you can

    - say what a sum of lengths does wrong, and what a concave penalty does about it;
    - build two surrogates that touch such a penalty from above, and say what each of them majorises;
    - iterate them, check the descent, and know when to believe a fixed point;
    - play with exponent, weight and noise, and see the membrane answer (last section).

    ## What l1 does wrong

    One force, no neighbours: $\min_{t \ge 0} (t - z)^2 + k\,\varphi(t)$, where $z$ is what the shape asks for. With
    $\varphi(t) = t$ the answer is $t = \max(z - k/2, 0)$: small forces go to zero, as wanted, but *every* force loses $k/2$.
    The paper's penalty

    $$\varphi(t) = (t^2 + \varepsilon)^{\alpha/2} - \varepsilon^{\alpha/2}, \qquad 0 < \alpha \le 1,$$

    is steep at small forces and almost flat at large ones: it still removes what is small, and hardly touches what stands. It
    is no longer convex. In the picture all three weights are such that a force of 1 costs the same.
    """)
    return


@app.function
def phi(size, alpha=ALPHA, eps=EPS):
    """The smoothed power, zero at zero."""
    return (size**2 + eps) ** (alpha / 2) - eps ** (alpha / 2)


@app.function
def slope(size, alpha=ALPHA, eps=EPS):
    """Its derivative."""
    return alpha * size * (size**2 + eps) ** (alpha / 2 - 1)


@app.cell
def _():
    _size, _wanted = np.linspace(0, 2, 2001), np.linspace(0, 2, 201)
    _figure, (_left, _right) = new_figure(8.4, 3.0, 2)
    for _alpha, _colour in zip((1.0, 0.5, 0.2), COLOURS, strict=False):
        _cost = phi(_size, _alpha, 1e-8) / phi(1.0, _alpha, 1e-8)
        _best = _size[np.argmin((_size[None] - _wanted[:, None]) ** 2 + 0.6 * _cost, axis=1)]
        _left.plot(_size, _cost, color=_colour, label=rf"$\alpha$ = {_alpha}")
        _right.plot(_wanted, _best, color=_colour)
        if _alpha == 1:
            assert np.allclose(_best, np.maximum(_wanted - 0.3, 0), atol=2e-3)  # of the grid
        else:
            # the library has this minimiser as the penalty's prox: (t - z)^2 / 2 + step phi(t)
            _prox = relax.Power(exponent=_alpha, smoothing=1e-8).prox(_wanted, 0.3 / phi(1.0, _alpha, 1e-8))
            assert np.mean(np.abs(_best - _prox) < 2e-3) > 0.98  # at the jump two minima are equal
            assert 2 - _best[-1] < 0.5 * 0.3  # less than half of the l1 loss
    _right.plot(_wanted, _wanted, ":", color=BLACK, label="no loss")
    for _axes in (_left, _right):
        _axes.legend(frameon=False)
    label(_left, "force t, N", "φ(t) / φ(1)", "What a force costs")
    label(_right, "force that the shape asks for, N", "force that is given, N", "What is left of it")
    _figure
    return


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## Majorise, minimise

    To lower a function that is hard, replace it by one that is easy, lies above it everywhere and touches it at the present
    point. Minimise that. The hard function has fallen at least as much (Hunter and Li 2005). Two surrogates for $R(p) = k
    \sum_i \varphi(|p_i|)$ at $|p_i| = t$:

    - **A parabola**, since $\varphi(\sqrt u)$ is concave in $u$: $\;\varphi(t) + b\,(|p|^2 - t^2)$, $\;b = \varphi'(t) /
      (2t)$. It touches $\varphi$ itself. The step is least squares: IRLS (Daubechies et al. 2010, for sparse recovery).
    - **A line** in $|p|$: $\;\psi(t) + w(t)(|p| - t)$. The step is lesson 3's: reweighted l1 (Candès, Wakin and Boyd 2008).
      But $\varphi$ is convex near zero, up to $t_1 = \sqrt{\varepsilon/(1-\alpha)}$, because it was smoothed; there a tangent
      crosses it. So take $w(t)$ as the largest slope from $t$ on. The line then touches $\psi = \int w$ from above, **not**
      $\varphi$; past $t_1$ the two differ by a constant.

    The often used weight $\alpha (t^2 + \varepsilon)^{(\alpha - 1)/2}$ majorises yet another function: a little left of $t$
    its line is below $\varphi$.
    """)
    return


@app.function
def weight(size, alpha=ALPHA, eps=EPS):
    """Largest slope of phi from `size` on."""
    return slope(np.maximum(size, np.sqrt(eps / (1 - alpha))), alpha, eps)


@app.function
def psi(size, alpha=ALPHA, eps=EPS):
    """Integral of the weight from 0: a straight line up to t1, then phi and a constant."""
    first = np.sqrt(eps / (1 - alpha))
    return weight(0.0, alpha, eps) * np.minimum(size, first) + phi(np.maximum(size, first), alpha, eps) - phi(first, alpha, eps)


@app.cell
def _():
    _eps, _t = 0.01, 0.3  # so large that it shows
    _size = np.linspace(0, 1, 1001)
    _line = psi(_t, ALPHA, _eps) + weight(_t, ALPHA, _eps) * (_size - _t)
    _parabola = phi(_t, ALPHA, _eps) + slope(_t, ALPHA, _eps) / (2 * _t) * (_size**2 - _t**2)
    assert np.all(_line >= psi(_size, ALPHA, _eps) - 1e-15) and np.all(_parabola >= phi(_size, ALPHA, _eps) - 1e-15)
    _usual = phi(_t, ALPHA, _eps) + ALPHA * (_t**2 + _eps) ** ((ALPHA - 1) / 2) * (_size - _t)
    assert (_usual - phi(_size, ALPHA, _eps)).min() < -1e-4  # no majoriser of phi
    assert np.allclose(weight(_size, ALPHA, _eps), relax.Power(exponent=ALPHA, smoothing=_eps).weight(_size))

    _figure, (_left, _right) = new_figure(8.4, 3.0, 2)
    _left.plot(_size, phi(_size, ALPHA, _eps), color=BLACK, label="φ")
    _left.plot(_size, _parabola, color=ORANGE, label="parabola (IRLS)")
    _right.plot(_size, psi(_size, ALPHA, _eps), color=BLUE, label="ψ")
    _right.plot(_size, _line, color=GREEN, label="line (reweighted l1)")
    _right.plot(_size, phi(_size, ALPHA, _eps), ":", color=BLACK, label="φ")
    for _axes, _height in ((_left, phi(_t, ALPHA, _eps)), (_right, psi(_t, ALPHA, _eps))):
        _axes.plot(_t, _height, "o", color=BLACK)
        _axes.set_ylim(0, 1)
        _axes.legend(frameon=False)
        label(_axes, "force, N", "cost", "touching from above at 0.3 N")
    _figure
    return


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## Reweighted l1

    The first weights are all alike (group lasso), then each force sets its own: large ones become cheap, zeros stay dear. The
    steps are the library's convex step of lesson 3.
    """)
    return


@app.cell
def _():
    net = three_masts()
    inverse = np.linalg.inv(net.stiffness)
    problem = net.problem(relax.Power(exponent=ALPHA, smoothing=EPS), STRENGTH)
    _plain = problem.linearised(problem.scene.start, problem.factor_at(problem.scene.start), np.ones(len(net.free)))

    def distance(forces):
        return np.sum((net.offset + inverse @ forces) ** 2)

    def _row(step, forces):
        size = sizes(forces)
        far = distance(forces)
        return step, int((size > 0).sum()), far + STRENGTH * psi(size).sum(), far + STRENGTH * phi(size).sum()

    _lasso = STRENGTH * phi(0.25) / 0.25  # a force of 0.25 N costs the same
    lines = working_set(replace(_plain, weights=np.full(len(net.free), _lasso)), _plain.nothing).amplitudes
    _rows = [_row("group lasso", lines)]
    for _step in range(1, 7):
        _weights = STRENGTH * weight(sizes(lines))
        lines = working_set(replace(_plain, weights=_weights), lines).amplitudes
        _rows.append(_row(_step, lines))

    assert _rows[0][1] > 10 and _rows[-1][1] == 3
    assert all(after[2] <= before[2] * (1 + 1e-12) for before, after in pairwise(_rows))  # psi descends
    # the fixed point is stationary for R itself: what a little more force gains is what it costs
    _stands = sizes(lines) > 0
    _dual = 2 * inverse @ (net.offset + inverse @ lines)
    _along = -np.sum(_dual * lines, axis=1)[_stands] / sizes(lines)[_stands]
    assert np.allclose(_along, STRENGTH * slope(sizes(lines)[_stands]), rtol=1e-5)
    _shown = [(step, count, f"{one:.10f}", f"{other:.10f}") for step, count, one, other in _rows]
    mo.md(table(("step", "forces", "distance + k Σψ, m²", "distance + k Σφ, m²"), _shown))
    return distance, inverse, lines, net, problem


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## IRLS

    With parabolas the step is one linear system, the same for x, y and z: $(K^{-2} + \mathrm{diag}(k b))\,p = -K^{-1} c$. A
    force near zero has a $b$ near $\frac{\alpha}{2} \varepsilon^{\alpha/2 - 1}$, here 8000, and hardly comes back, so begin
    with a large smoothing: $\varphi(\sqrt{t^2 + \tau^2})$ with $\tau$ from the largest force down. At every fixed $\tau$ the
    smoothed objective falls. Forces are never exactly zero here; lesson 5 rounds them.
    """)
    return


@app.cell
def _(distance, inverse, lines, net, problem):
    _gram, _right_side = inverse @ inverse, -inverse @ net.offset
    parabolas = np.linalg.solve(_gram, _right_side)  # lesson 2's useless answer
    _history, _tau = [sizes(parabolas)], sizes(parabolas).max()
    while _tau > 1e-4 * sizes(parabolas).max():

        def _smoothed(forces, tau=_tau):
            return distance(forces) + STRENGTH * np.sum(phi(np.hypot(sizes(forces), tau)) - phi(tau))

        for _ in range(3):
            _before, _h = _smoothed(parabolas), np.hypot(sizes(parabolas), _tau)
            parabolas = np.linalg.solve(_gram + np.diag(STRENGTH * slope(_h) / (2 * _h)), _right_side)
            assert _smoothed(parabolas) <= _before * (1 + 1e-12)
        _history.append(sizes(parabolas))
        _tau *= 0.6

    # both surrogates, and the library's own solver, end at the same three masts
    _three = np.sort(np.argsort(-sizes(parabolas))[:3])
    assert np.array_equal(_three, np.flatnonzero(sizes(lines)))
    assert np.allclose(parabolas[_three], lines[_three], atol=2e-3) and sizes(parabolas).min() > 0
    design = relax.solve(problem)
    assert np.array_equal(np.flatnonzero(design.forces.any(axis=1)), net.free[_three])
    assert np.isclose(design.certificate.objective, distance(lines) + STRENGTH * phi(sizes(lines)).sum(), rtol=1e-8)

    _figure, (_axes,) = new_figure(6.4, 3.0)
    _axes.semilogy(np.array(_history), color="#bbbbbb", linewidth=0.6)
    _axes.semilogy(np.array(_history)[:, _three], color=BLUE, linewidth=2)
    label(_axes, "step of the continuation", "force, N", "IRLS: all look alike at first, three are left")
    _figure
    return


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## What alpha does

    Least squares on the three places, without any penalty, gives the forces that the noisy shape asks for. Each $k$ is such
    that a force of 0.25 N costs the same. The smaller $\alpha$, the smaller the loss.
    """)
    return


@app.cell
def _(inverse, net):
    _three = np.flatnonzero(net.planted[net.free].any(axis=1))
    _asked = sizes(np.linalg.lstsq(inverse[:, _three], -net.offset)[0])
    _rows = []
    for _alpha in (1.0, 0.8, 0.5, 0.2):
        _size = sizes(answer(net, _alpha, 0.027).forces)[net.free]
        _rows.append((_alpha, int((_size > 0).sum()), *(_size[_three] / _asked)))
    assert [row[1] for row in _rows[1:]] == [3, 3, 3] and _rows[0][1] > 10
    assert all(np.all(np.diff([row[i] for row in _rows]) > 0) for i in (2, 3, 4))  # less loss with every smaller alpha

    # over a wide range of weights: alpha = 1 never has the three planted places alone, alpha = 1/2 mostly
    def _right(alpha, price):
        return np.array_equal(answer(net, alpha, price).forces.any(axis=1), net.planted.any(axis=1))

    assert not any(_right(1.0, price) for price in PRICES) and sum(_right(0.5, price) for price in PRICES) >= 4
    mo.md(table(("alpha", "forces", *(f"mast at {net.free[i]}, share of the force" for i in _three)), _rows))
    return


@app.function
def answer(net: Net, alpha: float, price: float) -> relax.Design:
    """The library's design, where a force of 0.25 N costs `price` square metres."""
    penalty = relax.GroupLasso() if alpha == 1 else relax.Power(exponent=alpha)
    return relax.solve(net.problem(penalty, price / float(penalty.value(np.array(0.25)))))


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## Play

    Move a slider (in the browser: `marimo run experiments/lessons/4_concave.py`). Things to look for: with $\alpha = 1$ no
    weight on this slider leaves exactly the three planted masts under noise; with $\alpha = 0.5$ there is a wide range of
    them; the weakest mast goes first.
    """)
    return


@app.cell
def _():
    exponent = mo.ui.slider(0.2, 1.0, 0.1, value=0.5, label="alpha", show_value=True)
    price = mo.ui.slider(steps=PRICES, value=0.03, label="weight: cost of 0.25 N, m²", show_value=True)
    noise = mo.ui.slider(0.0, 0.02, 0.0025, value=0.01, label="noise, m", show_value=True)
    mo.hstack([exponent, price, noise], wrap=True, justify="start", gap=1)
    return exponent, noise, price


@app.cell
def _(exponent, noise, price):
    _begin = time.perf_counter()
    _net = three_masts(noise.value)
    answered = answer(_net, exponent.value, price.value)
    _solved = time.perf_counter() - _begin
    _picture = quick_picture(_net.mesh, answered.positions, _net.wanted, answered.forces, _net.planted)
    _said = answered.certificate
    _words = f"**{_said.supports} supports**, rms distance {_said.rms_distance:.4f} m, solved in {1000 * _solved:.0f} ms"
    mo.vstack([mo.md(_words), mo.Html(_picture)])
    return


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## Exercises

    1. **Where the jump is.** For $\varepsilon = 0$ and $\alpha = 1/2$, from which $z$ on is the minimiser of $(t - z)^2 + k
       \sqrt t$ not zero? Check by a grid.
    2. **Log-sum.** $\varphi(t) = s \log(1 + t/s)$ is concave from zero on. Which weight and which parabola belong to it? Does
       $\psi = \varphi$ hold here?
    3. **A bad start.** Start the reweighting with weights from forces that are right but at the wrong places. Does it always
       find them?
    4. **How far off.** The usual weight's fixed points miss the stationarity of R. Show that the miss is about $\varepsilon /
       (2 t^2)$ of the slope.

    Solutions: `solutions/4_concave.py`.

    **Read on.** D. R. Hunter, R. Li, *Variable selection using MM algorithms*, Annals of Statistics 33 (2005) 1617-1642. E.
    J. Candès, M. B. Wakin, S. P. Boyd, *Enhancing sparsity by reweighted l1 minimization*, J. Fourier Anal. Appl. 14 (2008)
    877-905. I. Daubechies, R. DeVore, M. Fornasier, C. S. Güntürk, *Iteratively reweighted least squares minimization for
    sparse recovery*, Comm. Pure Appl. Math. 63 (2010) 1-38.
    """)
    return


if __name__ == "__main__":
    app.run()
