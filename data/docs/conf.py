"""Sphinx settings of the documentation, which `make docs` builds.

The source folder is the root of the checkout, so that a link from a page to a README or a file is
the same on the site as in the checkout. Nothing in a built page is loaded from another host.
"""

import os
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from docutils.nodes import SkipNode
from docutils.utils.math.latex2mathml import tex2mathml

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT)]

import wrenchbook  # noqa: E402
from data.docs.generated import navigation  # noqa: E402

project = "wrenchbook"
author = "the wrenchbook maintainers"
release = version = wrenchbook.__version__

extensions = ["myst_nb"]
root_doc = "data/docs/index"
include_patterns = [
    "data/docs/**.md",
    "data/docs/**.ipynb",
    "**README.md",
    "CHANGELOG.md",
    "SECURITY.md",
]
exclude_patterns = [".*", "**/.*", "build", "dist", "src", "tests", "wrenchbook-data"]
default_role = "code"
suppress_warnings = ["misc.highlighting_failure"]  # replies with "..." in them

smartquotes = False  # an option is --server, not a dash

# Prose is MyST Markdown.
myst_enable_extensions = ["dollarmath", "amsmath", "deflist"]
myst_heading_anchors = 4

# Notebooks are executed by each build, with a server that the build starts.
nb_execution_mode = os.environ.get("DOCS_NOTEBOOKS", "force")
nb_execution_timeout = 1800  # s: it hangs; beside other programs a solve takes minutes
nb_execution_raise_on_error = True

html_theme = "furo"
html_title = f"wrenchbook {release}"
html_favicon = "../../service/page/icon.svg"
html_extra_path = ["site"]
html_static_path = ["style.css"]
html_css_files = ["style.css"]
html_copy_source = False
html_show_copyright = False
html_show_sourcelink = False
html_math_renderer = "mathml"


def inline_formula(translator, node):
    """Write a formula as MathML, which browsers show without a script."""
    translator.body.append(tex2mathml(node.astext()))
    raise SkipNode


def displayed_formula(translator, node):
    """Write a formula in lines of its own."""
    formula = tex2mathml(node.astext(), as_block=True)
    translator.body.append(f'<div class="math">{formula}</div>\n')
    raise SkipNode


def append_navigation(app, docname, source):
    """Append the navigation of the site to its first page."""
    if docname == root_doc:
        source[0] += navigation()


def start_server(app):
    """Start a server with an empty data directory; name it to the notebooks once it answers."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    app.data = tempfile.TemporaryDirectory()
    program = [sys.executable, "-m", "wrenchbook", "serve", "--port", str(port)]
    app.server = subprocess.Popen([*program, "--data", app.data.name], stdout=subprocess.DEVNULL)
    os.environ["WRENCHBOOK_SERVER"] = f"http://127.0.0.1:{port}"
    while app.server.poll() is None:
        try:
            socket.create_connection(("127.0.0.1", port)).close()
            return
        except ConnectionRefusedError:
            time.sleep(0.1)
    raise RuntimeError(f"the server of the notebooks ended with status {app.server.returncode}")


def end_server(app, error):
    """End the server of the notebooks."""
    app.server.terminate()
    app.server.wait()
    app.data.cleanup()


def setup(app):
    """Register the functions above with Sphinx."""
    app.add_html_math_renderer("mathml", (inline_formula, None), (displayed_formula, None))
    app.connect("source-read", append_navigation)
    if nb_execution_mode != "off":
        app.connect("builder-inited", start_server)
        app.connect("build-finished", end_server)
