"""Lesson 1: a tent from one spring up, equilibrium and form-finding."""

import marimo

__generated_with = "0.25.2"
app = marimo.App(app_title="1. A tent from one spring up")

with app.setup:
    from pathlib import Path

    import marimo as mo
    import numpy as np
    from drawing import BLUE, COLOURS, draw_shape, label, new_figure, table

    import relax

    DATA = Path(__file__).resolve().parents[2] / "data"


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    # 1. A tent from one spring up

    **Goals.** After this lesson you can

    - write the force of a spring as minus the slope of its energy, and its stiffness as the slope of its force;
    - say what prestress does, and what a stiffness matrix that is not positive definite means;
    - bring a net to rest by Newton's method, and check the derivatives that it needs;
    - find a shape by force densities, and say when that is one linear solve.

    Lengths are metres, forces newtons. The notation is that of `relax/MATHEMATICS.md`.

    ## One spring

    A spring of length $l$, rest length $L$ and constant $k$ stores the energy $e(l)$ and pulls with the tension $e'(l)$:

    $$e(l) = \frac{k}{2}(l - L)^2, \qquad e'(l) = k\,(l - L), \qquad e''(l) = k .$$

    Everything else in this lesson follows from these three. The next cell checks the first derivative by a central
    difference. Do that with every derivative you write: wrong ones often work, slowly.
    """)
    return


@app.function
def energy(length, rest, constant):
    """Stored energy, newton metres."""
    return 0.5 * constant * (length - rest) ** 2


@app.function
def tension(length, rest, constant):
    """Pull, newtons; negative where the spring pushes."""
    return constant * (length - rest)


@app.cell
def _():
    _step = 1e-5
    _slope = (energy(1.2 + _step, 0.7, 3.0) - energy(1.2 - _step, 0.7, 3.0)) / (2 * _step)
    assert abs(_slope - tension(1.2, 0.7, 3.0)) < 1e-9
    mo.md(f"slope of the energy {_slope:.9f} N, tension {tension(1.2, 0.7, 3.0):.9f} N")
    return


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## Two springs, and what prestress does

    Put a vertex between two springs with $k = 1$ N/m that end at walls 1 m to its left and right, and push it up by $h$. Each
    spring is now $l = \sqrt{1 + h^2}$ long and pulls down with its tension times $h/l$. The vertex rests where the push is

    $$p(h) = 2 k\,(l - L)\,\frac{h}{l} = 2 q h, \qquad q = \frac{e'(l)}{l} .$$

    The ratio $q$ of tension to length is the **force density**. At $h = 0$ the slope of $p$ is $2 q = 2 k (1 - L)$: across
    itself a spring resists by its tension alone, not by $k$. So

    - $L < 1$: taut. The flat net is stiff from the start. This is prestress.
    - $L = 1$: no tension. The slope is zero, and $p \approx k h^3$: small forces move it far.
    - $L > 1$: the springs push. The slope is negative: the flat shape is an equilibrium, but nothing stays there.
    """)
    return


@app.function
def push(height, rest):
    """Force that holds the vertex between two springs of k = 1 at `height`."""
    length = np.sqrt(1 + height**2)
    return 2 * tension(length, rest, 1.0) * height / length


@app.cell
def _():
    assert np.isclose(push(1e-6, 0.7) / 1e-6, 2 * (1 - 0.7))  # taut: 2 k (1 - L)
    assert np.isclose(push(1e-2, 1.0) / 1e-6, 1.0, rtol=1e-3)  # not taut: h^3
    assert push(1e-2, 1.3) < 0  # it must be held down, or it leaves

    _figure, (_axes,) = new_figure(6.0, 3.0)
    _height = np.linspace(0, 1, 200)
    for _rest, _colour, _words in zip((0.7, 1.0, 1.3), COLOURS, ("taut", "just not taut", "too long"), strict=False):
        _axes.plot(_height, push(_height, _rest), color=_colour, label=f"L = {_rest} m, {_words}")
    _axes.axhline(0, color="#999999", linewidth=0.8)
    _axes.legend(frameon=False)
    label(_axes, "height h, m", "push p, N", "Prestress is stiffness")
    _figure
    return


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## Many springs

    An edge runs from vertex $a$ to $b$: $v = x_b - x_a$, $l = |v|$, $u = v / l$. It pulls $a$ with $q v$ and $b$ with $-q v$.
    The sum at the free vertices is $f(x)$. Moving $b$ by $d$ changes the edge vector by $d$, so the pull on $a$ by

    $$\left[\,q I + (e'' - q)\,u u^T\right] d .$$

    Along $u$ the bracket is $e''$, across it $q$, as the two springs showed. These blocks, put in their places, give $K(x) =
    -\partial f / \partial x$. It is the second derivative of the energy, so it is symmetric.
    """)
    return


@app.function
def internal_forces(positions, edges, rest, constant):
    """Sum of the pulls on every vertex (V, 3)."""
    vector = positions[edges[:, 1]] - positions[edges[:, 0]]
    length = np.linalg.norm(vector, axis=1)
    pull = (tension(length, rest, constant) / length)[:, None] * vector
    total = np.zeros_like(positions)
    np.add.at(total, edges[:, 0], pull)
    np.add.at(total, edges[:, 1], -pull)
    return total


@app.function
def stiffness(positions, edges, rest, constant):
    """Minus the derivative of the forces, of all vertices (3V, 3V), dense."""
    vector = positions[edges[:, 1]] - positions[edges[:, 0]]
    length = np.linalg.norm(vector, axis=1)
    along = vector / length[:, None]
    density = tension(length, rest, constant) / length
    outer = along[:, :, None] * along[:, None, :]
    blocks = density[:, None, None] * np.eye(3) + (constant - density)[:, None, None] * outer
    whole = np.zeros((len(positions), 3, len(positions), 3))
    for one, other, sign in ((0, 0, 1), (1, 1, 1), (0, 1, -1), (1, 0, -1)):
        np.add.at(whole, (edges[:, one], slice(None), edges[:, other], slice(None)), sign * blocks)
    return whole.reshape(3 * len(positions), -1)


@app.cell
def _():
    _rng = np.random.default_rng(0)
    _shape, _move = _rng.normal(size=(2, 5, 3))
    _springs = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [4, 0], [0, 2]]), _rng.uniform(0.3, 0.9, 6), _rng.uniform(1, 3, 6)
    _exact = -(stiffness(_shape, *_springs) @ _move.ravel()).reshape(-1, 3)

    def _error(step):
        ahead, behind = internal_forces(_shape + step * _move, *_springs), internal_forces(_shape - step * _move, *_springs)
        return np.abs((ahead - behind) / (2 * step) - _exact).max()

    _steps = 1e-2 * 0.5 ** np.arange(5)
    _errors = np.array([_error(step) for step in _steps])
    # a central difference errs by its step squared: halve the step, and a right derivative leaves a quarter of the error
    assert np.allclose(_errors[:-1] / _errors[1:], 4, rtol=0.05)
    mo.md(table(("step", "largest error of the central difference, N/m"), zip(_steps, _errors, strict=True)))
    return


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## A tent

    `data/tent.toml` is a net of 21 x 21 vertices with a fixed edge, cut to 70 % of its size so that every edge is taut. One
    mast pushes with $p = (0.04, -0.02, 0.3)$ N at vertex 181. Form-finding asks for the shape at which every free vertex is
    in balance:

    $$f(x) + p = 0 .$$

    Newton replaces $f(x + d)$ by $f(x) - K d$ and solves $K d = f + p$. That is also the step to the lowest point of the
    parabola that touches the potential $\Pi(x) = \text{energy} - p \cdot x$, so where $K$ is positive definite the step goes
    downhill. A full step may still go too far: halve it until $\Pi$ falls.
    """)
    return


@app.function
def newton(scene, applied):
    """The shape at rest under `applied` forces (V, 3) from the flat start, and the largest unbalanced force after each step."""
    springs = scene.mesh.edges, scene.rest_length, scene.spring_constant
    free = np.flatnonzero(~scene.fixed)
    rows = (3 * free[:, None] + np.arange(3)).ravel()

    def potential(positions):
        length = np.linalg.norm(positions[springs[0][:, 1]] - positions[springs[0][:, 0]], axis=1)
        return energy(length, *springs[1:]).sum() - np.sum(applied * positions)

    positions, history = scene.start.copy(), []
    for _ in range(30):
        unbalanced = (internal_forces(positions, *springs) + applied)[free]
        history.append(np.linalg.norm(unbalanced, axis=1).max())
        if history[-1] < 1e-14:  # round-off of forces of order 0.1
            break
        step = np.zeros_like(positions)
        step[free] = np.linalg.solve(stiffness(positions, *springs)[np.ix_(rows, rows)], unbalanced.ravel()).reshape(-1, 3)
        while history[-1] > 1e-6 and potential(positions + step) > potential(positions):  # below, round-off hides the fall
            step /= 2
        positions = positions + step
    return positions, np.array(history)


@app.cell
def _():
    scene = relax.load_scene(DATA / "tent.toml")
    mast = np.zeros_like(scene.target)
    mast[181] = [0.04, -0.02, 0.3]
    tent, _history = newton(scene, mast)
    assert _history[-1] < 1e-14
    # near the end Newton is quadratic: each residual is below a constant times the square of the one before
    _late = (_history[:-1] < 1e-2) & (_history[1:] > 1e-13)
    assert _late.any() and np.all(_history[1:][_late] < 20 * _history[:-1][_late] ** 2)

    _figure, (_axes,) = new_figure(5.0, 2.8)
    _axes.semilogy(_history, "o-", color=BLUE)
    label(_axes, "Newton step", "largest unbalanced force, N", "The number of right digits doubles")
    _figure
    return mast, scene, tent


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    The library's own form-finding must agree, and both must give the mesh that the scene was planted with.
    """)
    return


@app.cell
def _(mast, scene, tent):
    _found = relax.form(relax.Problem(scene), mast)
    assert np.abs(_found.positions - tent).max() < 1e-12
    assert np.abs(scene.target - tent).max() < 1e-12
    mo.md(f"`relax.form`: {_found}")
    return


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## Force densities: form-finding in one linear solve

    In $f$ the edges enter as $q v$. If the force densities $q$ are *given*, $f$ is linear in $x$. With the branch-node matrix
    $C$ (edge vectors are $C x$) and $Q = \mathrm{diag}(q)$, equilibrium is

    $$C^T Q C\, x = p ,$$

    with the columns of fixed vertices moved to the right. The matrix is the same for x, y and z (Schek 1974). Two things to
    see: with the force densities of our tent the solve gives the tent; with the same $q$ in every edge it gives another shape
    under the same mast. Such a net is linear, $K$ does not depend on $x$, and lessons 2 to 5 use it to see the inverse
    problem without Newton in the way.
    """)
    return


@app.function
def by_force_density(scene, density, applied):
    """The shape of given force densities (E,) under `applied` forces (V, 3)."""
    count, edges = len(scene.start), scene.mesh.edges
    branch = np.zeros((len(edges), count))
    branch[np.arange(len(edges)), edges[:, 0]] = -1
    branch[np.arange(len(edges)), edges[:, 1]] = 1
    whole = branch.T @ (density[:, None] * branch)
    free, fixed = np.flatnonzero(~scene.fixed), np.flatnonzero(scene.fixed)
    positions = scene.start.copy()
    right = applied[free] - whole[np.ix_(free, fixed)] @ positions[fixed]
    positions[free] = np.linalg.solve(whole[np.ix_(free, free)], right)
    return positions


@app.cell
def _(mast, scene, tent):
    _length = np.linalg.norm(tent[scene.mesh.edges[:, 1]] - tent[scene.mesh.edges[:, 0]], axis=1)
    _density = tension(_length, scene.rest_length, scene.spring_constant) / _length
    assert np.abs(by_force_density(scene, _density, mast) - tent).max() < 1e-12
    _even = by_force_density(scene, np.full(len(_length), 0.3), mast)
    assert np.abs(_even - tent).max() > 0.01  # other force densities, another shape

    _figure, (_left, _right) = new_figure(7.6, 2.8, 2)
    draw_shape(_left, scene.mesh, tent, mast)
    draw_shape(_right, scene.mesh, _even, mast)
    _left.set_title(f"elastic springs: tip at {tent[181, 2]:.3f} m", fontsize=10)
    _right.set_title(f"q = 0.3 N/m in every edge: tip at {_even[181, 2]:.3f} m", fontsize=10)
    _figure
    return


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## Exercises

    1. **By hand.** Four springs ($k = 1$ N/m, rest length 3/4 m) join a vertex to the points $(\pm 1, 0, 0)$, $(0, \pm 1,
       0)$. Which force holds it at a height of 3/4 m? (The edges are then 5/4 m long.) Check with `internal_forces`.
    2. **Balance.** What do the fixed vertices of the tent carry together? Say it first, then compute it.
    3. **No prestress.** Show that $K$ of a flat net with $L = l$ is singular, and say which movements cost nothing.
    4. **More prestress.** Cut the tent to 50 % and to 90 % instead of 70 %. How high does the same mast lift it? Explain the
       order.

    Solutions: `solutions/1_tent.py`.

    **Read on.** H.-J. Schek, *The force density method for form finding and computation of general networks*, Comput. Methods
    Appl. Mech. Eng. 3 (1974) 115-134.
    """)
    return


if __name__ == "__main__":
    app.run()
