import numpy as np
import pytest

from relax.sparsity.faces import face_at, projected_gradient
from relax.sparsity.reach import Reach

REACHES = {
    "anything": Reach(),
    "vertical": Reach((2,)),
    "up": Reach((2,), 0.0),
    "lean 20": Reach(tangent=np.tan(np.radians(20.0))),
    "largest": Reach(largest=0.7),
    "vertical, largest": Reach((2,), None, 0.4),
    "lean 50, largest": Reach(tangent=np.tan(np.radians(50.0)), largest=0.6),
}
every_reach = pytest.mark.parametrize("reach", REACHES.values(), ids=REACHES)


def quadratic(width, seed):
    """A definite matrix H (6c, 6c) and a vector b (6, c): the gradient at s is H s + b."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(6 * width, 6 * width))
    return root @ root.T + 0.5 * np.eye(6 * width), rng.normal(size=(6, width)) * 4


def minimiser(reach, matrix, linear):
    """By projected gradient, the long way."""
    step = 1 / np.linalg.eigvalsh(matrix)[-1]
    s = np.zeros_like(linear)
    for _ in range(40_000):
        s = reach.project(s - step * ((matrix @ s.ravel()).reshape(s.shape) + linear))
    return s


@every_reach
@pytest.mark.parametrize("seed", range(4))
def test_newton_steps_on_the_face_reach_the_minimum_quadratically(reach, seed):
    """Started beside it, on a convex quadratic: each step must shrink the error far faster than a gradient step."""
    matrix, linear = quadratic(len(reach.axes), seed)
    best = minimiser(reach, matrix, linear)
    tau = np.full(6, 0.05)
    rng = np.random.default_rng(seed)
    s = reach.project(best + 1e-3 * rng.normal(size=best.shape))
    errors = [np.abs(s - best).max()]
    for _ in range(5):
        gradient = (matrix @ s.ravel()).reshape(s.shape) + linear
        face = face_at(reach, s, gradient, tau)
        along = np.linalg.solve(face.hessian(matrix), -face.gradient(matrix))
        s = s + face.step(along).reshape(s.shape)
        errors.append(np.abs(s - best).max())
    assert errors[-1] <= 1e-12, errors


@every_reach
def test_the_projected_gradient_vanishes_at_the_minimum_alone(reach):
    matrix, linear = quadratic(len(reach.axes), 9)
    best = minimiser(reach, matrix, linear)
    tau = np.linspace(0.01, 0.2, 6)

    def left(s):
        return np.abs(projected_gradient(reach, s, (matrix @ s.ravel()).reshape(s.shape) + linear, tau)).max()

    assert left(best) < 1e-12
    assert left(reach.project(best + 1e-4)) > 1e-5
    if reach.constrained:
        assert np.abs((matrix @ best.ravel()).reshape(best.shape) + linear).max() > 0.1  # something binds


def test_where_nothing_binds_it_is_the_gradient_and_newtons_own_step():
    matrix, linear = quadratic(3, 3)
    wide = Reach(largest=1e6)
    s = np.ones((6, 3))
    gradient = (matrix @ s.ravel()).reshape(s.shape) + linear
    tau = np.full(6, 0.1)
    assert np.allclose(projected_gradient(wide, s, gradient, tau), gradient, rtol=1e-12)
    assert projected_gradient(Reach(), s, gradient, tau) is gradient
    for reach in (wide, Reach()):
        face = face_at(reach, s, gradient, tau)
        step = face.step(np.linalg.solve(face.hessian(matrix), -face.gradient(matrix)))
        assert np.allclose(step, np.linalg.solve(matrix, -gradient.ravel()), rtol=1e-9)


def test_all_that_is_pushed_to_the_tip_goes_there_in_one_step():
    """Every support of an upward cone pulled down: no direction is left, and the step is -s."""
    s = np.array([[0.2], [0.1]])
    face = face_at(Reach((2,), 0.0), s, np.full((2, 1), 10.0), np.ones(2))
    assert face.basis.shape == (2, 0)
    assert np.allclose(face.step(np.zeros(0)), -s.ravel())
