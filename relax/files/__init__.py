"""Scenes in, results out."""

from relax.files.results import check_output, write_result
from relax.files.scenes import load_scene
from relax.files.stored import StoredResult, load_result

__all__ = ["StoredResult", "check_output", "load_result", "load_scene", "write_result"]
