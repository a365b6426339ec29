"""The page of a design: one file that opens from disk, to turn the membrane and to go through the steps of its run."""

from relax.plots.page.page import draw_page

__all__ = ["draw_page"]
