"""`view.html` put together: the page's words, style, content, library and script in one file that loads nothing."""

import hashlib
import json
import os
import re
from base64 import b64encode
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from relax.plots.page.content import page_content
from relax.plots.view import View, look_at

if TYPE_CHECKING:
    from relax.design.solve import Design

SCRIPTS = ("record.js", "ground.js", "struts.js", "space.js", "page.js")  # in this order, as one script
HIDDEN = {"<": "\\u003c", ">": "\\u003e", "&": "\\u0026", "\u2028": "\\u2028", "\u2029": "\\u2029"}


def draw_page(design: "Design", path: str | os.PathLike[str]) -> None:
    """Write the page of `design` to `path`, one HTML file that needs no network; the same design gives the same bytes.

    It shows the wanted shape, the membrane and its distance to it, the supports with their figures, and the steps of the
    run; long runs are thinned to what a page of some megabytes holds, and the page says so. Its script is three.js, of
    which the file holds a copy, and what lies beside this module. A content security policy inside the file lets no
    other script run and no address be loaded.
    """
    view = look_at(design)
    style, library, script = _asset("page.css"), _asset("three.min.js"), "".join(_asset(name) for name in SCRIPTS)
    parts = {
        "title": escape(design.problem.scene.title),
        "summary": escape(_summary(design, view)),
        "policy": f"default-src 'none'; img-src data:; style-src {_hash(style)}; script-src {_hash(library)} {_hash(script)}",
        "style": style,
        "content": _harmless(json.dumps(page_content(design, view), allow_nan=False, separators=(",", ":"))),
        "library": library,
        "script": script,
    }
    # in one pass: what is put in is not looked at again, whatever it holds
    text = re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], _asset("page.html"))
    Path(path).write_text(text, encoding="utf-8", newline="\n")


def _summary(design: "Design", view: View) -> str:
    said = design.certificate
    verdict = "converged" if said.converged else f"not converged ({design.stop})"
    return f"{view.counted}; rms distance {said.rms_distance:.3g} m, objective {said.objective:.5g}; {verdict}."


def _asset(name: str) -> str:
    return (files(__package__) / name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    """Source expression of the content security policy that lets exactly `text` run."""
    return f"'sha256-{b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _harmless(text: str) -> str:
    """JSON without the characters that could end the element it stands in."""
    return re.sub("|".join(HIDDEN), lambda match: HIDDEN[match[0]], text)
