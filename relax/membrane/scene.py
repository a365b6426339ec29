"""A scene: the membrane, the shape that is wanted and where supports may stand, as arrays, and the settings they came from."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from relax.arrays import Floats, Ints, Mask, lock_arrays
from relax.factor import Engine
from relax.membrane.material import make_material, rest_shape
from relax.membrane.membrane import Membrane
from relax.membrane.mesh import Mesh, vertex_areas
from relax.membrane.places import candidate_vertices, check_floating, fixed_vertices, support_weights
from relax.membrane.springs import SPRINGS
from relax.membrane.target import check_coordinates, metric_blocks, with_noise

Settings = Mapping[str, Mapping[str, Any]]
BY_VERTEX = ("target", "clean_target", "start", "loads", "fixed", "candidates", "metric", "support_weight")
MOST_PARTS = 32  # scenes that one is cut into; more parts share them, for each step of a trace holds the whole membrane


@dataclass(frozen=True)
class Scene:
    """Everything a run needs, and all that a result keeps of it.

    Parameters
    ----------
    mesh : Mesh
    target, clean_target : (V, 3) metres
        The wanted positions as used (with noise, if any) and before noise.
    start : (V, 3) metres
        Flat shape with the fixed vertices in their places, from which form-finding starts.
    rest_length, spring_constant : (E,) metres, newtons per metre
    loads : (V, 3) newtons
    fixed, candidates : (V,) bool
        Held vertices, and those where a support may stand.
    metric : (V, 3, 3)
        Blocks of E_dist; square metres with area weights, else pure numbers.
    support_weight : (V,)
        Factor of each vertex's penalty; 0 where a support always stands.
    settings : the scene file's sections and keys, in full, as resolved
    engine : str or Engine
        Who factorises the stiffness, see Membrane; no part of a result.
    remarks : sentences on what was noticed while the scene was built; no part of a result
    """

    mesh: Mesh
    target: Floats
    clean_target: Floats
    start: Floats
    rest_length: Floats
    spring_constant: Floats
    loads: Floats
    fixed: Mask
    candidates: Mask
    metric: Floats
    support_weight: Floats
    settings: Settings = field(repr=False)
    engine: str | Engine = "auto"
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        lock_arrays(self)

    @property
    def title(self) -> str:
        return str(self.settings["title"])

    @property
    def ground(self) -> float:
        """Height of the ground, metres."""
        return float(self.settings["supports"]["ground"])

    @cached_property
    def membrane(self) -> Membrane:
        law = SPRINGS[self.settings["membrane"]["springs"]]
        return Membrane(self.mesh.edges, self.rest_length, self.spring_constant, law, self.fixed, self.engine)

    @cached_property
    def parts(self) -> tuple["ScenePart", ...]:
        """Scenes that share no free vertex and together are this one; none where it does not fall apart."""
        label = self.membrane.parts
        if not label.max(initial=0):
            return ()
        label = label % MOST_PARTS
        return tuple(self._part(self.membrane.free[label == which]) for which in range(int(label.max()) + 1))

    def _part(self, free: Ints) -> "ScenePart":
        """The scene of some free vertices and the fixed ones beside them; `free` (n,) are all those of some parts."""
        inside = np.zeros(self.mesh.vertices, dtype=bool)
        inside[free] = True
        mine = inside[self.mesh.edges].any(axis=1)
        inside[self.mesh.edges[mine]] = True
        vertices = np.flatnonzero(inside)
        index = np.full(self.mesh.vertices + 1, -1)  # the last one for the -1 that pads triangles
        index[vertices] = np.arange(len(vertices))
        faces = self.mesh.faces[(inside[self.mesh.faces] | (self.mesh.faces < 0)).all(axis=1)]
        by_vertex = {name: getattr(self, name)[vertices] for name in BY_VERTEX}
        by_edge = {name: getattr(self, name)[mine] for name in ("rest_length", "spring_constant")}
        mesh = Mesh(len(vertices), index[faces], index[self.mesh.edges[mine]])
        return ScenePart(replace(self, mesh=mesh, **by_vertex, **by_edge), vertices)

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """Sentences on what will surprise: the remarks, and the share of edges that the wanted shape leaves slack."""
        if self.settings["membrane"]["springs"] == "force-density":
            return self.remarks
        vector = self.clean_target[self.mesh.edges[:, 1]] - self.clean_target[self.mesh.edges[:, 0]]
        slack = float(np.mean(np.linalg.norm(vector, axis=1) < self.rest_length))
        if slack == 0:
            return self.remarks
        return (
            *self.remarks,
            f"membrane.rest_scale: {slack:.1%} of the edges are slack in the wanted shape, shorter than their rest length; "
            "a fabric cannot push: lower rest_scale for more prestress",
        )


@dataclass(frozen=True)
class ScenePart:
    """A scene cut out of another, and the vertices (v,) of that one which are its own, ascending."""

    scene: Scene
    vertices: Ints


def build_scene(settings: Settings, mesh: Mesh, target: Floats, rest: Floats | None) -> Scene:
    """The arrays of a scene from its resolved settings.

    Parameters
    ----------
    settings : sections and keys of relax/FORMATS.md, complete; `supports.ground` and the penalty are filled in by the caller
    mesh : Mesh
    target : (V, 3) metres
        Clean target; noise is added here, last.
    rest : (V, 3) metres or None
        Vertices of the rest mesh where `membrane.rest` names a file.

    Raises
    ------
    InputError
        Names section, key and index.
    """
    membrane, supports = settings["membrane"], settings["supports"]
    target = np.asarray(target, dtype=np.float64)
    rest = None if rest is None else np.asarray(rest, dtype=np.float64)
    check_coordinates(target)
    plan = target * [1.0, 1.0, 0.0]
    fixed = fixed_vertices(supports["fixed"], mesh, target)
    shape = rest_shape(membrane, target, rest)
    material = make_material(membrane, mesh, shape, target, fixed)
    candidates = candidate_vertices(supports, fixed, mesh, target)
    remarks = (*material.remarks, *check_floating(settings, fixed, candidates, mesh))
    area = vertex_areas(plan, mesh)
    start = shape.copy() if isinstance(rest, np.ndarray) else plan
    start[fixed] = target[fixed]
    return Scene(
        mesh=mesh,
        target=with_noise(target, settings["target"]["noise"], fixed),
        clean_target=target,
        start=start,
        rest_length=material.rest_length,
        spring_constant=material.spring_constant,
        loads=area[:, None] * np.asarray(membrane["loads"], dtype=float),
        fixed=fixed,
        candidates=candidates,
        metric=metric_blocks(settings["target"], mesh, target, area, fixed),
        support_weight=support_weights(supports, candidates, target),
        settings=settings,
        remarks=remarks,
    )
