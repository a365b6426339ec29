"""Lesson 3: the convex step in twenty lines of cvxpy, duality and the certificate."""

import marimo

__generated_with = "0.25.2"
app = marimo.App(app_title="3. The convex step and its certificate")

with app.setup:
    import cvxpy as cp
    import marimo as mo
    import numpy as np
    from drawing import BLUE, ORANGE, draw_plan, label, mark, new_figure, table
    from nets import DATA, sizes, three_masts

    import relax
    from relax.convex.backends import BACKENDS
    from relax.convex.subproblem import certify

    # square metres per newton
    WEIGHT = 0.2


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    # 3. The convex step, duality and the certificate

    **Goals.** After this lesson you can

    - state the convex step of sparse form-finding and solve it with cvxpy;
    - derive a lower bound of its optimum in three lines, and turn it into a duality gap for *any* answer, whoever gave it;
    - read the dual variable as a picture of where a mast would pay;
    - build a solver that looks at few candidates, and know when it may stop.

    ## The problem

    Near a shape $x$ the membrane moves linearly: $K d = f + g + p$, with loads $g$. The convex step looks for the
    displacement $d$ and the support forces $p$ of

    $$\min_{d,\,p}\; |x - \hat x + d|^2 + \sum_i w_i\,|p_i| \qquad \text{s.t.}\quad K d = f + g + p .$$

    $|p_i|$ is the length of a force, not its square: a sum of lengths is zero in many places at its minimum (group lasso;
    Bach et al. 2012), a sum of squares nowhere (lesson 2). Distance and lengths are convex, the constraint is linear. Our net
    has three planted masts and 1 % noise. It is linear and at rest when flat, so there $f + g = 0$, and with $c =
    x_{\mathrm{flat}} - \hat x$ the step *is* the whole problem:
    """)
    return


@app.function
def solve_step(stiffness, offset, weight):
    """Forces (n, 3), optimal value, and the multiplier of the constraint (n, 3), by a cone solver."""
    d = cp.Variable(offset.shape)
    p = cp.Variable(offset.shape)

    distance = cp.sum_squares(offset + d)
    masts = weight * cp.sum(cp.norm(p, 2, axis=1))
    equilibrium = stiffness @ d == p

    problem = cp.Problem(cp.Minimize(distance + masts), [equilibrium])
    problem.solve(solver="CLARABEL")
    return p.value, problem.value, equilibrium.dual_value


@app.cell
def _():
    net = three_masts()
    forces, optimum, multiplier = solve_step(net.stiffness, net.offset, WEIGHT)
    mo.md(f"optimum {optimum:.8f} m², {np.sum(sizes(forces) > 1e-3)} forces above a thousandth of a newton, of {len(forces)}")
    return forces, multiplier, net, optimum


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## A lower bound in three lines

    Eliminate $d = K^{-1} p$ and write $u = c + K^{-1} p$. Take any $\lambda$ (one vector a vertex) with $|\lambda_i| \le
    w_i$, and $y = K \lambda$:

    1. $|u|^2 \ge y \cdot u - |y|^2 / 4$, since $|u - y/2|^2 \ge 0$.
    2. $y \cdot u = c \cdot K\lambda + \lambda \cdot p$, since $K$ is symmetric.
    3. $w_i |p_i| + \lambda_i \cdot p_i \ge 0$, since $|\lambda_i| \le w_i$ (Cauchy and Schwarz).

    Add them up: whatever $p$ is,

    $$|u|^2 + \sum_i w_i |p_i| \;\ge\; c \cdot K \lambda - \tfrac14 |K \lambda|^2 .$$

    The right side knows nothing of $p$: it is a lower bound of the optimum. All three are equalities when $y = 2u$, that is

    $$\lambda = 2 K^{-1}(c + K^{-1} p), \qquad
    \lambda_i = -w_i \frac{p_i}{|p_i|} \text{ where } p_i \ne 0, \qquad |\lambda_i| \le w_i \text{ elsewhere.}$$

    These are the **optimality conditions**. For an answer that is not optimal, that $\lambda$ may stick out of its balls;
    scale it by $\theta$ until it fits. The difference between value and bound, the **duality gap**, says how far the answer
    can be from the optimum. It costs two solves and trusts no solver.
    """)
    return


@app.function
def certificate(stiffness, offset, weight, forces):
    """Value, lower bound, and lambda (n, 3) of any forces (n, 3)."""
    moved = offset + np.linalg.solve(stiffness, forces)  # u
    dual = 2 * np.linalg.solve(stiffness, moved)
    value = np.sum(moved**2) + weight * sizes(forces).sum()
    # with y = 2 theta u the bound is 2 theta c.u - theta^2 |u|^2, concave in theta
    largest = weight / sizes(dual).max()
    theta = np.clip(np.sum(offset * moved) / np.sum(moved**2), -largest, largest)
    return value, theta * (2 * np.sum(offset * moved) - theta * np.sum(moved**2)), dual


@app.cell
def _(forces, multiplier, net, optimum):
    value, bound, dual = certificate(net.stiffness, net.offset, WEIGHT, forces)
    assert bound <= value and (value - bound) / value < 1e-6  # a cone solver's own tolerance is 1e-8
    assert np.isclose(value, optimum)
    assert np.allclose(multiplier, -dual, atol=1e-6)  # cvxpy found the same lambda, with the other sign

    _rng = np.random.default_rng(0)
    for _ in range(100):  # the bound of any other forces is a bound as well, mostly a worse one
        _other = forces + _rng.normal(0, 10.0 ** _rng.uniform(-6, 0), forces.shape)
        _value, _bound, _ = certificate(net.stiffness, net.offset, WEIGHT, _other)
        assert _bound <= value and bound <= _value
    mo.md(f"value {value:.9f} m², bound {bound:.9f} m², relative gap {(value - bound) / value:.1e}")
    return bound, dual, value


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## Who stands is read from the dual

    The solver's forces are never exactly zero, so a threshold on them reads its noise. The dual tells: where $|\lambda_i| <
    w_i$ by a margin, no mast stands, in *any* optimal answer.

    The picture is worth more than the list. $|\lambda_i|$ is what a first newton at vertex $i$ would gain, $w_i$ what it
    costs. The field touches 1 at the masts and nowhere exceeds it: **no further mast pays**, for all vertices at once, by one
    solve.
    """)
    return


@app.cell
def _(dual, forces, net):
    _ratio = sizes(dual) / WEIGHT
    standing = _ratio > 1 - 1e-4
    assert _ratio.max() < 1 + 1e-5
    assert np.array_equal(standing, sizes(forces) > 1e-5)
    assert sizes(forces)[~standing].min() > 0  # solver noise: small, not zero
    _planted = sizes(net.planted[net.free])
    assert standing.sum() == 9 and np.all(standing[_planted > 0]) and np.all((sizes(forces) < _planted)[_planted > 0])

    _figure, (_left, _right) = new_figure(8.4, 3.4, 2)
    _scale = draw_plan(_left, net.mesh, net.flat, net.on_vertices(_ratio), top=1.0)
    mark(_left, net.flat[net.free[standing]], "stands")
    label(_left, "x, m", "y, m", "gain over cost of a first newton")
    _figure.colorbar(_scale, ax=_left)
    _right.semilogy(np.sort(sizes(forces))[::-1], "o", markersize=3, color=BLUE)
    _right.axvline(standing.sum() - 0.5, color=ORANGE, label="the dual's answer")
    _right.legend(frameon=False)
    label(_right, "forces, sorted", "force, N", "What the cone solver calls zero")
    _figure
    return (standing,)


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    Nine stand, where three were planted: the others are small and follow the noise, and each planted one is too weak. That is
    the price of convexity; lesson 4 deals with it.

    ## A working set

    Few masts stand, so few candidates matter. Start with none. Solve for the members alone, compute $\lambda$ for *all*
    vertices, let in those with the largest $|\lambda_i| > w_i$, repeat. The gap of the whole problem says when to stop.
    """)
    return


@app.cell
def _(bound, net, value):
    _columns = np.linalg.inv(net.stiffness)
    _members, history = np.zeros(0, dtype=int), []
    _forces = np.zeros_like(net.offset)
    for _ in range(20):
        _value, _bound, _dual = certificate(net.stiffness, net.offset, WEIGHT, _forces)
        history.append((len(_members), _value, _bound, (_value - _bound) / _value))
        if history[-1][3] < 1e-7:
            break
        _pull = sizes(_dual)
        _pull[_members] = 0
        _worst = np.argsort(-_pull)[:4]
        _members = np.union1d(_members, _worst[_pull[_worst] > WEIGHT])
        _p = cp.Variable((len(_members), 3))
        _moved = net.offset + _columns[:, _members] @ _p
        _cost = cp.sum_squares(_moved) + WEIGHT * cp.sum(cp.norm(_p, 2, axis=1))
        cp.Problem(cp.Minimize(_cost)).solve(solver="CLARABEL")
        _forces = np.zeros_like(net.offset)
        _forces[_members] = _p.value

    _members, _values, _bounds, _gaps = np.array(history).T
    assert _gaps[-1] < 1e-7 and _members[-1] < 30
    assert np.all(np.diff(_values) <= 1e-9) and np.all(_values >= bound) and np.all(_bounds <= value)
    mo.md(table(("members of 121", "value, m²", "bound, m²", "relative gap"), history))
    return (history,)


@app.cell
def _(history):
    _members, _values, _bounds, _ = np.array(history).T
    _figure, (_axes,) = new_figure(5.6, 2.6)
    _axes.plot(_members, _values, "o-", color=BLUE, label="value")
    _axes.plot(_members, _bounds, "o-", color=ORANGE, label="bound")
    _axes.fill_between(_members, _bounds, _values, color="#dddddd", label="where the optimum is")
    _axes.legend(frameon=False)
    label(_axes, "candidates looked at, of 121", "value, m²", "A gap that closes")
    _figure
    return


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## The library's

    In `relax` the step is a value, `Subproblem`, and whoever solves it a function. The certificate is computed from the
    step's data, never taken from the solver. The back-ends must agree with the twenty lines above; the one that cannot take
    round cones says so.
    """)
    return


@app.cell
def _(net, optimum, standing):
    def _by_all(problem):
        problem = relax.resolve_weight(problem)
        start = problem.scene.start
        step = problem.linearised(start, problem.factor_at(start), problem.strength * np.ones(len(problem.supports.vertices)))
        found = []
        for name, backend in BACKENDS.items():
            try:
                solution = backend(step, step.nothing)
            except relax.BackendError as refused:
                found.append((name, str(refused), "", ""))
            else:
                found.append((name, f"{solution.value:.12g}", float(solution.gap), int(solution.standing.sum())))
        return step, found

    step, _rows = _by_all(net.problem(relax.GroupLasso(), WEIGHT))
    _solved = [row for row in _rows if row[0] != "osqp"]
    assert all(np.isclose(float(row[1]), optimum, rtol=1e-6) and row[3] == standing.sum() for row in _solved)
    assert max(float(row[1]) for row in _solved) - min(float(row[1]) for row in _solved) < 1e-9 * optimum
    assert all(row[2] < 1e-9 for row in _solved)

    # the same on a membrane of elastic springs, linearised at its flat start: there it is a step, not the whole problem
    _, _elastic = _by_all(relax.Problem(relax.load_scene(DATA / "tent-noisy.toml"), penalty=relax.GroupLasso(), weight=0.05))
    _values = [float(row[1]) for row in _elastic if row[0] != "osqp"]
    assert max(_values) - min(_values) < 1e-8 * max(_values)
    mo.md(
        table(
            ("back-end", "value, m²", "relative gap", "stand"),
            [*_rows, ("*tent-noisy, at its flat start:*", "", "", ""), *_elastic],
        )
    )
    return (step,)


@app.cell
def _(forces, net, step):
    # its certificate is the one that we wrote
    _theirs = certify(step, forces)
    _value, _bound, _dual = certificate(net.stiffness, net.offset, WEIGHT, forces)
    assert np.isclose(_theirs.value, _value, rtol=1e-12) and np.isclose(_theirs.bound, _bound, rtol=1e-9)
    assert np.allclose(_theirs.dual, _dual, atol=1e-12)
    return


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## Exercises

    1. **Largest useful weight.** From which $w$ on does nothing stand? Find the formula from the optimality conditions at $p
       = 0$, and check it 1 % above and below.
    2. **Price of the weight.** Let $V(w)$ be the optimal value. Show $V'(w) = \sum_i |p_i|$ and check it by differences.
    3. **Shadow price.** A small load $g$ acts at a vertex beside the supports. Show that the optimal value changes by
       $\lambda \cdot g$.
    4. **Vertical masts.** Change `solve_step` so that masts only push along z. What happens to the value, and to the test by
       $\lambda$?

    Solutions: `solutions/3_convex.py`.

    **Read on.** F. Bach, R. Jenatton, J. Mairal, G. Obozinski, *Optimization with sparsity-inducing penalties*, Foundations
    and Trends in Machine Learning 4 (2012) 1-106.
    """)
    return


if __name__ == "__main__":
    app.run()
