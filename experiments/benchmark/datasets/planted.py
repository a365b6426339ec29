"""Square membranes at rest under five masts, as the target, with noise (price.py, ablation.py)."""

from benchmark_utils import EXPERIMENTS  # noqa: F401 - puts the experiments on the path
from benchopt import BaseDataset

from ablation import Kind, planted  # isort: skip  # found by what benchmark_utils puts on the path


class Dataset(BaseDataset):
    """`side` x `side` vertices; `direction` is what the scene allows its supports."""

    name = "planted"
    parameters = {"side, direction": [(21, "any"), (50, "any"), (21, "vertical")]}  # noqa: RUF012 - benchopt's way

    def get_data(self):
        return {"problem": planted(Kind(sigma=0.005, direction=self.direction), self.side)}
