from dataclasses import replace
from inspect import signature

import numpy as np
import pytest
import zoo

import relax
from relax.design.form import NOTES, form
from relax.design.problem import Problem
from relax.errors import InputError
from relax.iterate import Stop
from relax.membrane.formers import FORMERS
from relax.membrane.springs import SPRINGS

every_method = pytest.mark.parametrize("method", FORMERS)


def test_it_is_public_and_every_way_has_its_note():
    assert relax.form is form and list(signature(form).parameters) == ["problem", "forces", "method", "callback"]
    assert set(NOTES) == set(FORMERS)


@pytest.mark.parametrize("springs", SPRINGS)
@every_method
def test_the_planted_shape_again_from_flat(method, springs):
    planted = zoo.planted(9, zoo.TWO_MASTS, membrane__springs=springs, membrane__loads=[0.01, 0, -0.05])
    told = []
    shaped = form(Problem(planted.scene), planted.forces, method, told.append)
    np.testing.assert_allclose(shaped.positions, planted.positions, atol=1e-8)
    np.testing.assert_array_equal(shaped.forces, planted.forces)
    assert shaped.stop == Stop.CONVERGED.value and shaped.certificate.stable and shaped.certificate.equilibrium <= 1e-10
    assert shaped.trace.notes == (f"form-finding: {NOTES[method]}",)
    assert [record["note"] for record in told] == list(shaped.trace.notes)
    assert shaped.iterations > 0 and (shaped.factorizations == 0) == (method == "dynamic-relaxation")


def test_a_method_that_there_is_not():
    planted = zoo.planted(5)
    with pytest.raises(InputError, match=r"method 'magic' .*: give one of newton, dynamic-relaxation, force-density"):
        form(Problem(planted.scene), planted.forces, "magic")


@pytest.mark.parametrize(("method", "stop"), [("force-density", Stop.UNSTABLE), ("dynamic-relaxation", Stop.LOST_SUPPORT)])
def test_a_net_that_pushes_is_never_called_converged(method, stop):
    scene = zoo.force_density_net()
    scene = replace(scene, spring_constant=-scene.spring_constant)
    shaped = form(Problem(scene, weight=1.0), np.zeros_like(scene.target), method)
    assert shaped.stop == stop.value and not shaped.certificate.stable and not shaped.certificate.converged


def test_the_note_says_who_took_over():
    scene = zoo.grid_scene(8, membrane__springs="tension-only", membrane__rest_scale=0.5)
    crumpled = scene.start.copy()
    crumpled[scene.membrane.free] = np.random.default_rng(0).uniform(0, 1, (len(scene.membrane.free), 3))
    slack = replace(scene, rest_length=2.6 * scene.rest_length, start=crumpled)
    shaped = form(Problem(slack, weight=1.0), np.zeros_like(scene.target))
    assert shaped.trace.notes[-1].endswith(f"{NOTES['newton']}, then {NOTES['dynamic-relaxation']}")
    assert shaped.certificate.equilibrium == 0 and not shaped.certificate.stable
    assert shaped.stop == Stop.UNSTABLE.value
