"""Solutions of lesson 3."""

import marimo

__generated_with = "0.25.2"
app = marimo.App(app_title="3. Solutions")

with app.setup:
    import sys
    from pathlib import Path
    from runpy import run_path
    from types import SimpleNamespace

    import cvxpy as cp
    import marimo as mo
    import numpy as np

    LESSONS = Path(__file__).resolve().parents[1]
    sys.path.insert(0, str(LESSONS))
    # its functions; its cells do not run
    lesson = SimpleNamespace(**run_path(str(LESSONS / "3_convex.py")))


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    # 3. Solutions

    ## 1. Largest useful weight

    At $p = 0$ the conditions ask $|\lambda_i| \le w$ everywhere, with $\lambda = 2 K^{-1} c$. So nothing stands from $w =
    \max_i |(2 K^{-1} c)_i|$ on.
    """)
    return


@app.cell
def _():
    net = lesson.three_masts()
    _largest = lesson.sizes(2 * np.linalg.solve(net.stiffness, net.offset)).max()
    _none, _value, _ = lesson.solve_step(net.stiffness, net.offset, 1.01 * _largest)
    assert lesson.sizes(_none).max() < 1e-5 and np.isclose(_value, np.sum(net.offset**2))
    _some, _value, _ = lesson.solve_step(net.stiffness, net.offset, 0.99 * _largest)
    assert lesson.sizes(_some).max() > 1e-3 and _value < np.sum(net.offset**2)
    mo.md(f"largest useful weight {_largest:.4f} m²/N")
    return (net,)


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## 2. Price of the weight

    $V(w)$ is a minimum over $p$ of functions that are linear in $w$. Its slope is that of the one which is lowest, with its
    $p$ held still (the envelope theorem; Danskin): $V'(w) = \sum_i |p_i|$. As a minimum of linear functions V is also
    concave.
    """)
    return


@app.cell
def _(net):
    _step = 0.01
    _behind, _here, _ahead = (lesson.solve_step(net.stiffness, net.offset, lesson.WEIGHT + shift) for shift in (-_step, 0, _step))
    _slope = (_ahead[1] - _behind[1]) / (2 * _step)
    assert np.isclose(_slope, lesson.sizes(_here[0]).sum(), rtol=1e-3)
    assert _ahead[1] + _behind[1] < 2 * _here[1]
    return


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## 3. Shadow price

    A load g moves the net by $K^{-1} g$, so it changes c to $c + K^{-1} g$. By the envelope theorem again $dV = 2 u \cdot
    K^{-1} g = \lambda \cdot g$. That is why $\lambda$ is what a first newton would gain: a support force is a load that costs
    something.
    """)
    return


@app.cell
def _(net):
    _forces, _value, _multiplier = lesson.solve_step(net.stiffness, net.offset, lesson.WEIGHT)
    _load = np.zeros_like(net.offset)
    _load[60] = 1e-3 * np.array([1.0, -2.0, 3.0])
    _values = [
        lesson.solve_step(net.stiffness, net.offset + sign * np.linalg.solve(net.stiffness, _load), lesson.WEIGHT)[1]
        for sign in (1, -1)
    ]
    _dual = lesson.certificate(net.stiffness, net.offset, lesson.WEIGHT, _forces)[2]
    assert np.isclose((_values[0] - _values[1]) / 2, np.sum(_dual * _load), rtol=1e-2)
    return


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## 4. Vertical masts

    Fewer answers are allowed, so the value cannot fall. The test is by $\lambda_z$ alone: sideways a mast cannot push,
    however much that would gain.
    """)
    return


@app.cell
def _(net):
    _p = cp.Variable(len(net.offset))
    _columns = np.linalg.inv(net.stiffness)
    _moved = net.offset[:, 2] + _columns @ _p
    _problem = cp.Problem(cp.Minimize(cp.sum_squares(_moved) + lesson.WEIGHT * cp.norm1(_p)))
    _problem.solve(solver="CLARABEL")
    _value = _problem.value + np.sum(net.offset[:, :2] ** 2)  # no vertical force moves the net sideways
    assert _value > lesson.solve_step(net.stiffness, net.offset, lesson.WEIGHT)[1]
    _upward = 2 * _columns @ _moved.value
    assert np.abs(_upward).max() < lesson.WEIGHT * (1 + 1e-4)
    _vertical = np.column_stack([0 * _p.value, 0 * _p.value, _p.value])
    _whole = lesson.certificate(net.stiffness, net.offset, lesson.WEIGHT, _vertical)[2]
    assert lesson.sizes(_whole).max() > 1.05 * lesson.WEIGHT  # masts that may lean would pay
    return


if __name__ == "__main__":
    app.run()
