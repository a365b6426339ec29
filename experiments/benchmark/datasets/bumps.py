"""The scene `bumps`, its formula sampled at other sizes (price.py): no few supports reach it."""

from benchmark_utils import EXPERIMENTS  # noqa: F401 - puts the experiments on the path
from benchopt import BaseDataset
from price import bumps


class Dataset(BaseDataset):
    """`side` x `side` vertices."""

    name = "bumps"
    parameters = {"side": [36]}  # noqa: RUF012 - benchopt's way

    def get_data(self):
        return {"problem": bumps(self.side)}
