"""A scene: the membrane, the shape that is wanted and where supports may stand, as arrays, and the settings they came from."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from relax.arrays import Floats, Ints, Mask, lock_arrays
from relax.errors import InputError
from relax.factor import Engine
from relax.membrane.membrane import Membrane
from relax.membrane.mesh import (
    Mesh,
    boundary_vertices,
    component_labels,
    corner_vertices,
    edge_areas,
    vertex_areas,
)
from relax.membrane.springs import SPRINGS

Settings = Mapping[str, Mapping[str, Any]]
BY_VERTEX = ("target", "clean_target", "start", "loads", "fixed", "candidates", "metric", "support_weight")
MOST_PARTS = 32  # scenes that one is cut into; more parts share them, for each step of a trace holds the whole membrane
FARTHEST = 1e4  # scene sizes from the origin: beyond, the round-off of a position spoils the balance of forces


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
        Factor of each vertex's penalty.
    settings : the scene file's sections and keys, in full, as resolved
    engine : str or Engine
        Who factorises the stiffness, see Membrane; no part of a result.
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
        """Sentences on what will surprise: so far, the share of edges that the wanted shape leaves slack."""
        if self.settings["membrane"]["springs"] == "force-density":
            return ()
        vector = self.clean_target[self.mesh.edges[:, 1]] - self.clean_target[self.mesh.edges[:, 0]]
        slack = float(np.mean(np.linalg.norm(vector, axis=1) < self.rest_length))
        if slack == 0:
            return ()
        return (
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
    supports, noise = settings["supports"], settings["target"]["noise"]
    _check_coordinates(target)
    plan = target * [1.0, 1.0, 0.0]
    fixed = _fixed(supports["fixed"], mesh, target)
    _check_held(mesh, fixed)
    rest_shape = _rest_shape(settings, mesh, target, rest)
    rest_length, constant = _springs(settings["membrane"], mesh, rest_shape)
    area = vertex_areas(plan, mesh)
    used = target.copy()
    if noise is not None:
        free = np.flatnonzero(~fixed)
        used[free] += np.random.default_rng(noise["seed"]).normal(0.0, noise["sigma"], (len(free), 3))
    start = rest_shape.copy() if isinstance(rest, np.ndarray) else plan
    start[fixed] = target[fixed]
    scene = Scene(
        mesh=mesh,
        target=used,
        clean_target=target,
        start=start,
        rest_length=rest_length,
        spring_constant=constant,
        loads=area[:, None] * np.asarray(settings["membrane"]["loads"], dtype=float),
        fixed=fixed,
        candidates=_candidates(supports, fixed, mesh, target),
        metric=np.tile(np.eye(3), (mesh.vertices, 1, 1)),
        support_weight=np.ones(mesh.vertices),
        settings=settings,
    )
    if settings["membrane"]["springs"] != "force-density" and _all_slack(mesh, target, rest_length):
        raise InputError(
            "membrane.rest_scale: every edge is slack in the wanted shape, so no tension can hold it: lower rest_scale "
            f"(now {settings['membrane']['rest_scale']}) until the rest lengths are shorter than the target's edges"
        )
    return scene


def _all_slack(mesh: Mesh, target: Floats, rest_length: Floats) -> bool:
    """Whether no edge of the target is longer than its rest length by more than round-off."""
    length = np.linalg.norm(target[mesh.edges[:, 1]] - target[mesh.edges[:, 0]], axis=1)
    return bool((length <= rest_length * (1 + 1e-12)).all())


def _check_coordinates(target: Floats) -> None:
    """Refuse coordinates that are no numbers, or so far from the origin that double precision cannot hold the shape."""
    if not np.isfinite(target).all():
        vertex = int(np.argwhere(~np.isfinite(target))[0][0])
        raise InputError(f"target: vertex {vertex} is at {target[vertex].tolist()}: every coordinate must be a finite number")
    size, farthest = float(np.linalg.norm(np.ptp(target, axis=0))), float(np.abs(target).max())
    if farthest > FARTHEST * size:
        raise InputError(
            f"target: coordinates reach {farthest:.3g} m in a scene of {size:.3g} m, too far from the origin for forces to "
            "balance to the last digits: move the scene to the origin"
        )


def _vertex_list(key: str, vertices: list[int], mesh: Mesh) -> Mask:
    mask = np.zeros(mesh.vertices, dtype=bool)
    for vertex in vertices:
        if not 0 <= vertex < mesh.vertices:
            raise InputError(f"{key}: vertex {vertex} does not exist; the target has vertices 0 to {mesh.vertices - 1}")
        mask[vertex] = True
    return mask


def _fixed(choice: Any, mesh: Mesh, target: Floats) -> Mask:
    if choice == "boundary":
        return boundary_vertices(mesh)
    if choice == "corners":
        return corner_vertices(target, mesh)
    return _vertex_list("supports.fixed", [] if choice == "none" else choice, mesh)


def _check_held(mesh: Mesh, fixed: Mask) -> None:
    if fixed.all():
        raise InputError("supports.fixed: every vertex is fixed, so no membrane is left to shape: fix fewer, or refine the mesh")
    labels = component_labels(mesh)
    held = np.zeros(labels.max() + 1, dtype=bool)
    held[labels[fixed]] = True
    if not held.all():
        vertex = int(np.argmin(held[labels]))
        raise InputError(
            f"supports.fixed: no vertex is fixed in the part of the membrane that holds vertex {vertex}, so nothing keeps it "
            "in place: fix at least one vertex of each connected part"
        )


def _rest_shape(settings: Settings, mesh: Mesh, target: Floats, rest: Floats | None) -> Floats:
    choice = settings["membrane"]["rest"]
    if rest is None:
        return target if choice == "target" else target * [1.0, 1.0, 0.0]
    if rest.shape != target.shape:
        raise InputError(
            f"membrane.rest: {choice} has {len(rest)} vertices, the target {mesh.vertices}; a rest mesh needs the same numbering"
        )
    return rest


def _springs(membrane: Mapping[str, Any], mesh: Mesh, shape: Floats) -> tuple[Floats, Floats]:
    """Rest lengths and spring constants (E,); see MATHEMATICS.md, "Membrane"."""
    a, b = mesh.edges.T
    measured = np.linalg.norm(shape[b] - shape[a], axis=1)
    if not measured.all():
        edge = int(np.argmin(measured))
        raise InputError(
            f"membrane.rest: edge {edge} (vertices {a[edge]} and {b[edge]}) has a rest length of zero on the "
            f"{'plan of the target' if membrane['rest'] == 'plan' else 'rest mesh'}: part the two vertices, or name a rest mesh"
        )
    length = membrane["rest_scale"] * measured
    if membrane["springs"] == "force-density":
        return length, np.full(len(length), float(membrane["stiffness"]))
    if membrane["material"] == "cables":
        return length, membrane["stiffness"] / length
    area = edge_areas(shape, mesh)
    if not area.all():
        edge = int(np.argmin(area))
        raise InputError(
            f'membrane.material: the faces beside edge {edge} (vertices {a[edge]} and {b[edge]}) have no area, so "fabric" gives '
            'it no stiffness: mend the mesh or use "cables"'
        )
    return length, membrane["stiffness"] * area / measured**2


def _candidates(supports: Mapping[str, Any], fixed: Mask, mesh: Mesh, target: Floats) -> Mask:
    choice = supports["candidates"]
    if choice == "free":
        mask = ~fixed
    elif isinstance(choice, Mapping):
        low, high = np.asarray(choice["box"], dtype=float)
        mask = ~fixed & (target[:, :2] >= low).all(axis=1) & (target[:, :2] <= high).all(axis=1)
    else:
        mask = _vertex_list("supports.candidates", choice, mesh)
        if (mask & fixed).any():
            raise InputError(
                f"supports.candidates: vertex {np.argmax(mask & fixed)} is fixed, so no support can act there: "
                "take it out of candidates or of fixed"
            )
    mask &= ~_vertex_list("supports.never", supports["never"], mesh)
    if not mask.any():
        raise InputError("supports.candidates: no vertex is left where a support may stand: widen candidates or shorten never")
    return mask
