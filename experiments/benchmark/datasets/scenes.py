"""The scenes of data/, as they are."""

from benchmark_utils import EXPERIMENTS
from benchopt import BaseDataset

import relax


class Dataset(BaseDataset):
    """A scene by its name."""

    name = "scene"
    parameters = {"scene": ["tent", "five-masts", "tent-noisy", "bumps", "pavilion", "terrain"]}  # noqa: RUF012 - benchopt's way

    def get_data(self):
        problem = relax.Problem(relax.load_scene(EXPERIMENTS.parent / "data" / f"{self.scene}.toml"))
        return {"problem": relax.resolve_weight(problem)}
