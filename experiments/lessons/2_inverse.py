"""Lesson 2: why the inverse problem is ill-posed, and what sparsity buys."""

import marimo

__generated_with = "0.25.2"
app = marimo.App(app_title="2. Why the inverse problem is ill-posed")

with app.setup:
    from itertools import pairwise

    import marimo as mo
    import numpy as np
    from drawing import BLUE, ORANGE, draw_plan, draw_shape, label, mark, new_figure, table
    from nets import planted_net, sizes

    import relax

    # the vertex of the planted mast; the noise, metres: 1 % of the span
    MAST, SIGMA = 181, 0.01


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    # 2. Why the inverse problem is ill-posed, and what sparsity buys

    **Goals.** After this lesson you can

    - say why *any* wanted shape has support forces that hold it, and why they are useless;
    - predict from a spectrum what noise in the shape does to the forces;
    - say what Tikhonov regularisation repairs and what it cannot;
    - say why few unknowns, in a known or unknown place, are stable.

    Form-finding goes from forces to a shape. The inverse problem goes back: from a wanted shape $\hat x$ to the forces $p$
    that hold it. We take the linear net of lesson 1 (force density 0.3 N/m), flat without supports. All three coordinates
    have the same stiffness matrix $S$, so with the free positions and forces as tables of $n$ rows and three columns,
    equilibrium is

    $$S\,(x - x_{\mathrm{flat}}) = p, \qquad x = x_{\mathrm{flat}} + S^{-1} p .$$

    One mast was planted at vertex 181; noise of 1 % of the span is then added to the shape, as any survey or sculptor would.
    """)
    return


@app.cell
def _():
    clean = planted_net(21, 0.3, [(MAST, (0.04, -0.02, 0.3))])
    noisy = clean.noisy(SIGMA, seed=1)
    n = len(clean.free)
    mast = int(np.searchsorted(clean.free, MAST))  # its place among the free vertices

    _figure, (_left, _right) = new_figure(7.6, 2.8, 2)
    draw_shape(_left, clean.mesh, clean.wanted, clean.planted)
    draw_shape(_right, clean.mesh, noisy.wanted, 0 * clean.planted)
    _left.set_title("under the planted mast", fontsize=10)
    _right.set_title("the shape that is wanted: 1 % noise", fontsize=10)
    _figure
    return clean, mast, n, noisy


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## An answer that always exists

    Put $x = \hat x$ into the equation: $p = S(\hat x - x_{\mathrm{flat}})$ holds the wanted shape exactly, whatever it is.
    Without noise that is one mast. With noise $\nu$ it is the mast and $S\nu$ beside it: **361 forces, one at every free
    vertex**. The noise has variance $\sigma^2$ in every entry, so the mean square of the entries of $S \nu$ is
    $\sigma^2\,\mathrm{tr}(S^2)/n$. With 5 % noise the largest false force is larger than the mast.
    """)
    return


@app.cell
def _(clean, mast, n):
    def _answer(sigma):
        net = clean.noisy(sigma, seed=1) if sigma else clean
        forces = -net.stiffness @ net.offset
        wrong = forces - clean.planted[clean.free]
        predicted = sigma * np.sqrt(np.trace(net.stiffness @ net.stiffness) / n)
        size = sizes(forces)
        false = np.delete(size, mast).max()
        return sigma, int((size > 1e-12).sum()), size[mast], false, np.sqrt(np.mean(wrong**2)), predicted

    _rows = [_answer(sigma) for sigma in (0.0, 0.002, 0.01, 0.05)]
    assert [row[1] for row in _rows] == [1, n, n, n] and n == 361
    # 1083 squares average to within some 4 % of their mean
    assert all(abs(row[4] / row[5] - 1) < 0.1 for row in _rows[1:])
    assert _rows[3][3] > _rows[3][2]
    mo.md(table(("noise, m", "forces", "at the mast, N", "largest elsewhere, N", "rms error, N", "predicted, N"), _rows))
    return


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## The spectrum says why

    $S = V\,\mathrm{diag}(\kappa)\,V^T$. A unit force along the eigenvector $v_j$ moves the net by $1/\kappa_j$ along $v_j$.
    Smooth patterns have small $\kappa$ and move far; rough ones have large $\kappa$ and hardly move. Going back multiplies by
    $\kappa$: noise is as strong in rough patterns as in smooth ones, and exactly the rough ones are blown up. A pattern that
    moves the net by less than the noise cannot be seen in the shape at all. For a force of the mast's 0.3 N that is half of
    them. (The step in the middle is this mesh's own: half of its vertices have four edges, half eight.)

    Refine the mesh and it gets worse: $\kappa_{\max}/\kappa_{\min}$ grows four times with every halving. In the limit the
    forces do not depend continuously on the shape. A problem like that is **ill-posed** (Hadamard).
    """)
    return


@app.cell
def _(clean, n):
    kappa, modes = np.linalg.eigh(clean.stiffness)
    _noise = SIGMA * np.sqrt(n)  # the length of a column of noise
    _moved = np.linalg.norm(clean.planted[MAST]) / kappa
    assert 0.4 < np.mean(_moved < _noise) < 0.6

    _figure, (_left, _right) = new_figure(8.4, 3.0, 2)
    _left.semilogy(_moved, color=BLUE, label="moved by 0.3 N")
    _left.axhline(_noise, color=ORANGE, label="noise")
    _left.legend(frameon=False)
    label(_left, "pattern, smooth to rough", "length of the movement, m", "What forces do to the shape")
    for _which, _colour in ((2, BLUE), (n - 2, ORANGE)):
        _row = clean.on_vertices(modes[:, _which]).reshape(21, 21)[7]
        _right.plot(np.linspace(0, 1, 21), _row, "o-", color=_colour, markersize=3, label=f"κ = {kappa[_which]:.2g} N/m")
    _right.legend(frameon=False)
    label(_right, "x, m", "pattern along the row y = 0.35 m", "Smooth is soft, rough is stiff")
    _figure
    return kappa, modes


@app.cell
def _():
    _ratios = []
    for _side in (6, 11, 21):
        _kappa = np.linalg.eigvalsh(planted_net(_side, 0.3, []).stiffness)
        _ratios.append((_side, _kappa[-1] / _kappa[0]))
    assert all(3.5 < fine[1] / coarse[1] < 4.5 for coarse, fine in pairwise(_ratios))
    mo.md(table(("vertices a side", "largest over smallest κ"), _ratios))
    return


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## Tikhonov: small forces

    With $c = x_{\mathrm{flat}} - \hat x$ the distance to the wanted shape is $|c + S^{-1} p|^2$. Tikhonov adds $\mu |p|^2$.
    The sum is smooth and quadratic; its minimum, pattern by pattern, is

    $$V^T p = -\frac{1/\kappa}{1/\kappa^2 + \mu}\; V^T c .$$

    Rough patterns, where $1/\kappa^2 < \mu$, are damped. How large is $\mu$? So large that the distance is what the noise
    alone explains, $3 n \sigma^2$ (Morozov's discrepancy principle). The result is stable, and no use to a builder: the mast
    is spread over its surroundings, shrunk to a third, and *every* vertex still carries a force.
    """)
    return


@app.function
def tikhonov(kappa, modes, offset, damping):
    """Forces (n, 3) of least |c + S^-1 p|^2 + mu |p|^2, and their distance |c + S^-1 p|^2."""
    inside = -(1 / kappa / (1 / kappa**2 + damping))[:, None] * (modes.T @ offset)
    return modes @ inside, np.sum((modes.T @ offset + inside / kappa[:, None]) ** 2)


@app.cell
def _(kappa, mast, modes, n, noisy):
    _low, _high = 1e-8, 1e4
    for _ in range(60):  # bisection: the distance grows with mu
        _middle = np.sqrt(_low * _high)
        _far = tikhonov(kappa, modes, noisy.offset, _middle)[1] > 3 * n * SIGMA**2
        _low, _high = (_low, _middle) if _far else (_middle, _high)
    spread, _distance = tikhonov(kappa, modes, noisy.offset, _low)
    assert np.isclose(_distance, 3 * n * SIGMA**2)
    assert (sizes(spread) > 1e-6).sum() == n and sizes(spread)[mast] < 0.35 * 0.3
    # the formula is the minimum: the normal equations (S^-2 + mu) p = -S^-1 c hold
    _inverse = np.linalg.inv(noisy.stiffness)
    assert np.allclose(_inverse @ (_inverse @ spread) + _low * spread, -_inverse @ noisy.offset, rtol=0, atol=1e-10)
    return (spread,)


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## Sparsity: few forces

    Suppose there is one mast, and we know where: at vertex $i$. With $a_i$ the column $i$ of $S^{-1}$, three numbers remain,
    and least squares gives

    $$p_i = -\frac{a_i^T c}{|a_i|^2}, \qquad \text{standard deviation } \frac{\sigma}{|a_i|} \text{ in each coordinate.}$$

    361 noisy positions now speak for three numbers: the error is less than a fourth of that of the answer that always exists.
    The same prior, few forces, also finds the place: try every vertex, keep the one whose best mast leaves the least distance
    $|c|^2 - |a_i^T c|^2 / |a_i|^2$.
    """)
    return


@app.function
def best_single_masts(stiffness, offset):
    """The best force at each vertex alone (n, 3), and the distance that it leaves (n,)."""
    columns = np.linalg.inv(stiffness)
    square = np.sum(columns**2, axis=0)
    forces = -(columns.T @ offset) / square[:, None]
    return forces, np.sum(offset**2) - square * np.sum(forces**2, axis=1)


@app.cell
def _(clean, mast):
    _square = np.sum(np.linalg.inv(clean.stiffness)[:, mast] ** 2)
    _errors, _places = [], []
    for _seed in range(100):
        _forces, _left = best_single_masts(clean.stiffness, clean.noisy(SIGMA, _seed).offset)
        _errors.append(_forces[mast] - clean.planted[MAST])
        _places.append(clean.free[_left.argmin()])
    assert abs(np.std(_errors) / (SIGMA / np.sqrt(_square)) - 1) < 0.15  # of 300 numbers: known to some 4 %
    assert set(_places) == {MAST}  # 100 of 100
    _naive = SIGMA * np.linalg.norm(clean.stiffness[mast])
    assert _naive > 4.5 * SIGMA / np.sqrt(_square)
    mo.md(
        f"error of one mast {np.std(_errors):.4f} N (predicted {SIGMA / np.sqrt(_square):.4f}), of the answer that always exists "
        f"{_naive:.4f} N; vertex 181 found in 100 of 100 draws of the noise"
    )
    return


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    Trying every vertex works for one mast. For ten among 361 there are $10^{19}$ choices. The rest of the course is about
    asking for few forces without trying them all. The library does it here through the paper's penalty (lesson 4). With the
    penalty dropped on the support that it finds, its force must be the least-squares mast above.
    """)
    return


@app.cell
def _(clean, mast, noisy, spread):
    design = relax.solve(noisy.problem(relax.Power(exponent=0.5), weight=0.05, refit="debiased"))
    _forces, _left = best_single_masts(noisy.stiffness, noisy.offset)
    assert np.flatnonzero(design.forces.any(axis=1)).tolist() == [MAST]
    assert np.allclose(design.forces[MAST], _forces[mast], rtol=0, atol=1e-10)

    _naive = -noisy.stiffness @ noisy.offset
    _figure, _all = new_figure(9.6, 3.0, 3)
    _fields = (sizes(_naive), sizes(spread), sizes(design.forces)[clean.free])
    _words = ("exact: 361 forces", "Tikhonov: 361 forces", "few: 1 force")
    for _axes, _field, _word in zip(_all, _fields, _words, strict=True):
        _scale = draw_plan(_axes, clean.mesh, clean.flat, clean.on_vertices(_field), top=0.1)
        label(_axes, "x, m", "y, m", _word)
        mark(_axes, clean.flat[[MAST]], "planted")
    _figure.colorbar(_scale, ax=list(_all), label="force, N (0.1 and more)")
    _figure
    return


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## Exercises

    1. **A chain.** For $n$ equal force densities in a row between two walls, $S$ has $2q$ on the diagonal and $-q$ beside it.
       Show that its eigenvalues are $2 q (1 - \cos(j \pi / (n + 1)))$, and that $\kappa_{\max}/\kappa_{\min}$ grows with
       $n^2$.
    2. **Never zero.** Can $\mu$ be chosen so that Tikhonov's answer has fewer than 361 forces? Look at the smallest force
       over $\mu$.
    3. **Two masts.** Plant a second mast at vertex 90. Write a greedy search: place the best mast, fit all forces again, look
       where the next one leaves the least. Does it find both under 1 % noise?
    4. **Neighbours.** Two masts stand side by side and both places are known. By how much are their forces less certain than
       that of one mast alone? And if they stand far apart?

    Solutions: `solutions/2_inverse.py`.
    """)
    return


if __name__ == "__main__":
    app.run()
