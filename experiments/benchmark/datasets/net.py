"""Linear membranes under the group lasso: the one case where the whole problem is convex, with the design matrix K^-1 B."""

from benchmark_utils import EXPERIMENTS  # noqa: F401 - puts the experiments on the path
from benchopt import BaseDataset

from ablation import Kind, planted  # isort: skip  # found by what benchmark_utils puts on the path


class Dataset(BaseDataset):
    """A force-density net of `side` x `side` vertices that five masts planted, with noise."""

    name = "net"
    parameters = {"side": [13, 25]}  # noqa: RUF012 - benchopt's way

    def get_data(self):
        return {"problem": planted(Kind(sigma=0.005, springs="force-density", lasso=3.0), self.side)}
