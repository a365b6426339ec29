"""Solutions of lesson 1."""

import marimo

__generated_with = "0.25.2"
app = marimo.App(app_title="1. Solutions")

with app.setup:
    import sys
    from pathlib import Path
    from runpy import run_path
    from types import SimpleNamespace

    import marimo as mo
    import numpy as np

    import relax

    LESSONS = Path(__file__).resolve().parents[1]
    sys.path.insert(0, str(LESSONS))
    # its functions; its cells do not run
    lesson = SimpleNamespace(**run_path(str(LESSONS / "1_tent.py")))


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    # 1. Solutions

    ## 1. By hand

    Each spring is $\sqrt{1 + 9/16} = 5/4$ m long and pulls with $1 \cdot (5/4 - 3/4) = 1/2$ N. The vertical share is $h/l =
    3/5$. Four of them: $4 \cdot 1/2 \cdot 3/5 = 6/5$ N, straight up; the horizontal parts cancel.
    """)
    return


@app.cell
def _():
    _corners = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 0.75]])
    _spokes = np.array([[0, 4], [1, 4], [2, 4], [3, 4]])
    _pull = lesson.internal_forces(_corners, _spokes, 0.75, 1.0)
    assert np.allclose(_pull[4], [0, 0, -1.2], atol=1e-15)
    return


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## 2. Balance

    Every edge pulls its two ends with opposite forces, so all internal forces add up to zero. The free vertices have $f = -p$
    in sum, so the net pulls at the fixed ones with $+p$ in sum, and the frame must hold $-p$. The same holds for moments,
    which is why the frame cannot be anything.
    """)
    return


@app.cell
def _():
    scene = relax.load_scene(lesson.DATA / "tent.toml")
    mast = np.zeros_like(scene.target)
    mast[181] = [0.04, -0.02, 0.3]
    tent, _ = lesson.newton(scene, mast)
    _pull = lesson.internal_forces(tent, scene.mesh.edges, scene.rest_length, scene.spring_constant)
    assert np.allclose(_pull[scene.fixed].sum(axis=0), mast[181], atol=1e-13)
    assert np.allclose(np.cross(tent, _pull)[scene.fixed].sum(axis=0), np.cross(tent[181], mast[181]), atol=1e-13)
    return mast, scene


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## 3. No prestress

    With $l = L$ every $q$ is zero and a block is $k\,u u^T$. All $u$ lie in the plane, so no block resists a vertical
    movement: $K$ has one zero eigenvalue a free vertex, to first order the net can be pushed up and down for nothing. In the
    plane the triangles hold each other. Newton from here divides by zero; start from a shape that is not flat, or cut the
    membrane smaller.
    """)
    return


@app.cell
def _():
    _mesh = relax.grid_mesh(5, 5, "alternating")
    _row, _column = np.divmod(np.arange(25), 5)
    _flat = np.column_stack([_column, _row, 0 * _row]) / 4
    _inside = np.flatnonzero((_row % 4 > 0) & (_column % 4 > 0))
    _length = np.linalg.norm(_flat[_mesh.edges[:, 1]] - _flat[_mesh.edges[:, 0]], axis=1)
    _rows = (3 * _inside[:, None] + np.arange(3)).ravel()
    _whole = lesson.stiffness(_flat, _mesh.edges, _length, 1.0)[np.ix_(_rows, _rows)]
    _values, _vectors = np.linalg.eigh(_whole)
    _nothing = np.abs(_values) < 1e-12
    assert _nothing.sum() == len(_inside)
    assert np.allclose(_vectors[:, _nothing].reshape(-1, 3, len(_inside))[:, :2], 0, atol=1e-7)  # vertical movements alone
    return


@app.cell(hide_code=True)
def _():
    mo.md(r"""
    ## 4. More prestress

    The flat net resists a vertical push by $q = k (1 - L/l)$ alone. With a cut to 50 % that is $0.5 k$, with 90 % it is $0.1
    k$: the tighter membrane rises less. (The constant $k$ of a fabric does not change with the cut: the area and the squared
    length of an edge shrink alike.)
    """)
    return


@app.cell
def _(mast, scene):
    _tips = []
    for _scale in (0.5, 0.7, 0.9):
        _cut = relax.load_scene(lesson.DATA / "tent.toml", {"membrane.rest_scale": _scale})
        assert np.allclose(_cut.spring_constant, scene.spring_constant, rtol=1e-12)
        _tips.append(lesson.newton(_cut, mast)[0][181, 2])
    assert _tips[0] < _tips[1] < _tips[2]
    mo.md("tips at " + ", ".join(f"{_tip:.3f}" for _tip in _tips) + " m with 50, 70 and 90 %")
    return


if __name__ == "__main__":
    app.run()
