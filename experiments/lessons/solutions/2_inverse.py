"""Solutions of lesson 2."""

import marimo

__generated_with = "0.25.2"
app = marimo.App(app_title="2. Solutions")

with app.setup:
    import sys
    from pathlib import Path
    from runpy import run_path
    from types import SimpleNamespace

    import marimo as mo
    import numpy as np
    from scipy.linalg import toeplitz

    LESSONS = Path(__file__).resolve().parents[1]
    sys.path.insert(0, str(LESSONS))
    # its functions; its cells do not run
    lesson = SimpleNamespace(**run_path(str(LESSONS / "2_inverse.py")))


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    # 2. Solutions

    ## 1. A chain

    Try $v_m = \sin(m j \pi / (n + 1))$: it vanishes at both walls, and $\sin((m-1)\theta) + \sin((m+1)\theta) = 2 \cos\theta
    \sin(m \theta)$, so $S v = (2q - 2q\cos\theta)\,v$ with $\theta = j\pi/(n+1)$. The smallest is about $q\theta_1^2 = q
    \pi^2/(n+1)^2$, the largest about $4q$: the ratio grows like $4 (n+1)^2/\pi^2$.
    """)
    return


@app.cell
def _():
    for _n in (5, 50):
        _kappa = np.linalg.eigvalsh(toeplitz([2 * 0.3, -0.3, *np.zeros(_n - 2)]))
        assert np.allclose(_kappa, 2 * 0.3 * (1 - np.cos(np.arange(1, _n + 1) * np.pi / (_n + 1))), rtol=1e-10)
    assert np.isclose(_kappa[-1] / _kappa[0], 4 * (_n + 1) ** 2 / np.pi**2, rtol=1e-2)
    return


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## 2. Never zero

    No. Pattern by pattern the answer is a smooth multiple of $V^T c$. As $\mu$ grows all forces shrink together, none first.
    A square has slope zero at zero, so the last bit of a force costs nothing, while it still gains something.
    """)
    return


@app.cell
def _():
    net = lesson.planted_net(21, 0.3, [(181, (0.04, -0.02, 0.3))]).noisy(0.01, seed=1)
    _kappa, _modes = np.linalg.eigh(net.stiffness)
    for _damping in np.geomspace(1e-6, 1e6, 13):
        _size = lesson.sizes(lesson.tikhonov(_kappa, _modes, net.offset, _damping)[0])
        assert _size.min() > 1e-5 * _size.max()
    return (net,)


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## 3. Two masts

    This is orthogonal matching pursuit. The distance that is left tells when to stop: two masts leave what the noise
    explains, $3 n \sigma^2$.
    """)
    return


@app.function
def pursue(stiffness, offset, count):
    """Free vertices one after the other, each where it leaves least beside those before it, and the distance left."""
    columns, chosen = np.linalg.inv(stiffness), []
    left = np.zeros(len(columns))
    for _ in range(count):
        for vertex in range(len(columns)):
            some = columns[:, [*chosen, vertex]]
            fit = np.linalg.solve(some.T @ some, -some.T @ offset) if vertex not in chosen else np.zeros((len(chosen) + 1, 3))
            left[vertex] = np.sum((offset + some @ fit) ** 2)
        chosen.append(int(np.argmin(left)))
    return chosen, float(left.min())


@app.cell
def _():
    _two = lesson.planted_net(21, 0.3, [(181, (0.04, -0.02, 0.3)), (90, (0.0, 0.03, 0.2))]).noisy(0.01, seed=1)
    _found, _left = pursue(_two.stiffness, _two.offset, 2)
    assert sorted(_two.free[_found]) == [90, 181]
    assert abs(_left / (3 * len(_two.free) * 0.01**2) - 1) < 0.1
    return


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## 4. Neighbours

    With both places known the covariance of one coordinate of the two forces is $\sigma^2 (A^T A)^{-1}$, $A$ the two columns
    of $S^{-1}$. With $\gamma$ the cosine between the columns, $1/\sqrt{1 - \gamma^2}$ times the deviation of a single mast:
    neighbours have $\gamma = 0.95$ and are three times less certain, since one can take over from the other. Far apart there
    is next to no loss.
    """)
    return


@app.cell
def _(net):
    _columns = np.linalg.inv(net.stiffness)
    _place = {int(vertex): index for index, vertex in enumerate(net.free)}
    _ratios = []
    for _other in (182, 45):
        _pair = _columns[:, [_place[181], _place[_other]]]
        _gram = _pair.T @ _pair
        _ratio = np.sqrt(np.linalg.inv(_gram)[0, 0] * _gram[0, 0])
        _cosine = _gram[0, 1] / np.sqrt(_gram[0, 0] * _gram[1, 1])
        assert np.isclose(_ratio, 1 / np.sqrt(1 - _cosine**2))
        _ratios.append(_ratio)
    assert _ratios[0] > 3 and _ratios[1] < 1.1
    mo.md(f"{_ratios[0]:.2f} times beside each other, {_ratios[1]:.2f} times far apart")
    return


if __name__ == "__main__":
    app.run()
