"""Settings of all tests: hypothesis draws the same examples each run, BLAS keeps to one thread as in a solve."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "agg")

import pytest
from folders import LIGHT, write_scene
from hypothesis import settings

settings.register_profile("relax", derandomize=True, max_examples=25, deadline=None, database=None)
settings.load_profile("relax")


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with hill.toml, which is also the current one."""
    monkeypatch.chdir(tmp_path)
    write_scene(tmp_path, LIGHT)
    return tmp_path
